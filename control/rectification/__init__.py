"""Self-rectification: what a camera's pixels, lens and tilt do to the markers is estimated and removed."""
