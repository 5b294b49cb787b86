"""Cameras: intrinsics and poses, lenses, and what moves while an image is taken."""
