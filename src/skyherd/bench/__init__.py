"""Marker detectors measured: on drawn images (`detectors`), on boards and on photographs.

`entrants.py` has the detectors that take part, each a name or `module:factory`; `execution.py` runs them and
returns rows, `result.py` keeps these, and `table.py` and `measurement_page.py` show them, alike for all
three.
"""
