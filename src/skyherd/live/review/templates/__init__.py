"""The template of the page of a live run."""
