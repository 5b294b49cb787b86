"""Drawing into images: lines, arrows, text and shapes, and the project's colours."""
