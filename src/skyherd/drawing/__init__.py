"""Drawing into images: lines, text and shapes, and the project's colours."""
