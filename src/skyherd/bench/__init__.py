"""Benchmarks of marker detectors: on drawn images (`detectors`), on boards and on photographs.

`entrants.py` lists the detectors, each a name or `module:factory`. `execution.py` runs them and returns rows,
and `result.py` stores these. `table.py` and `measurement_page.py` show the results of all three.
"""
