"""`skyherd bench boards`: how accurate detectors are on photographs of calibration boards.

The board says where each marker must be, once all others are seen (leave one out). `layout.py` has the
boards, `board_fit.py` fits one image and `lens_degree.py` all of them, `board_errors.py` learns what the
board itself has wrong, `accuracy.py` makes errors of residuals, `measurement.py` runs the detectors, and
`tables.py`, `plots.py` and `page.py` show what came out.
"""
