"""The annotated video of a run: panels of the cameras, of the ground and of curves, composed to frames."""
