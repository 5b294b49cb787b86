"""The benchmark of marker detectors: all detectors on the same drawn images, against the Cramér–Rao bound.

`design.py` lists the cells (what is varied), `scene.py` places cameras and markers, `frames.py` renders
images with their truth and bounds, `scorer.py` scores detections, and `tables.py`, `plots.py` and `page.py`
show what came of it. A source of frames is a function of cell, dictionary and seed. Every cell begins with
new detectors, so that a tracker carries nothing over.
"""
