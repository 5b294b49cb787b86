"""The benchmark of marker detectors: all detectors on the same frames, compared with the Cramér–Rao bound.

`design.py` lists the cells (what is varied), `scene.py` places cameras and markers, `frames.py` renders
images with their truth and bounds, `execution.py` and `timing.py` run the detectors and return rows,
`scorer.py` scores them, `result.py` keeps the rows, and `tables.py`, `plots.py` and `page.py` show them. A
source of frames is a function of cell, dictionary and seed; a detector is a name or `module:factory`. Every
cell begins with new detectors, so that a tracker carries nothing over.
"""
