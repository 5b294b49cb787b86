"""Benchmark of marker detectors on common drawn images, against the Cramér–Rao bound.

`design.py` lists the cells (the conditions), `scene.py` places cameras and markers, `frames.py` renders
images with ground truth and bounds, `scorer.py` scores detections, and `tables.py`, `plots.py` and `page.py`
show the result. A source of frames is a function of cell, dictionary and seed. Every cell begins with new
detectors, so that a tracker keeps no state.
"""
