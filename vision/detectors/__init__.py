"""Detectors behind one interface, created by name, and their measured errors.

`registry` has the interface `Detector` and the factory function `create_detector`. `peers` wraps the
detectors of OpenCV and of other libraries. `accuracy` reads the tables of measured errors.
"""
