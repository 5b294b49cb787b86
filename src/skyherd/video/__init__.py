"""Annotated video of a run: panels of the cameras, of the ground and of curves in one frame."""
