"""Detectors by name behind one interface: the package's own, OpenCV's, others', and measured errors of each.

`registry` has the interface, `Detector`, and the function that creates detectors by name.
"""
