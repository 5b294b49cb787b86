"""Markers measured from their pixels: the fit of the known pattern, verified and followed."""
