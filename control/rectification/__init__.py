"""Self-rectification: estimation and removal of the effects of pixels, lens and tilt on the markers."""
