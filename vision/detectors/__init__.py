"""Detectors by name: ours, OpenCV's and others', and what is known of their errors."""
