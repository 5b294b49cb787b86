"""The annotated video of a run: its panels and how they are composed."""
