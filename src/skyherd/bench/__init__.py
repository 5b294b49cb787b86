"""The benchmark of marker detectors: the same frames for all, against the Cramér–Rao bound."""
