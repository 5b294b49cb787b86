"""The photometric fit: the unknowns of markers and image, by least squares on grey levels of pixels."""
