"""`skyherd bench boards`: accuracy of detectors on photographs of calibration boards.

The board predicts each marker's position from all others (leave one out).

- `layout.py` has the boards.
- `board_fit.py` fits one image and `lens_degree.py` all of them.
- `board_errors.py` estimates the errors of the board itself.
- `accuracy.py` converts residuals to errors.
- `measurement.py` runs the detectors.
- `tables.py`, `plots.py` and `page.py` show the result.
"""
