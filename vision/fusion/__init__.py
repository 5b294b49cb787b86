"""Fusion of several markers on a robot."""
