"""A study of cameras: how much a run depends on each parameter of its camera, measured and predicted."""
