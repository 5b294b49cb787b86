"""Cameras: poses, lenses, motion."""
