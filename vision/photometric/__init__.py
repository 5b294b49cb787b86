"""Markers measured by fitting their known pattern to the pixels; verified, and followed between images.

`detector` is the entrance and says how the parts work together.
"""
