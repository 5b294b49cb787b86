"""Cameras: intrinsics, poses, lenses, shutter and motion."""
