"""Compiled loops over the pixels of markers: the columns of the linear model, their products, and residuals.

- `scan_conversion`: which pixels of an image a marker has, and where on the marker they lie;
- `round_blur`, `elliptic_blur`: the model's columns at these pixels, under either kind of blur, of which
  `blurred_edges`, `card_edge` and `columns` are parts;
- `residual_sums`: what the model leaves of the pixels, summed over cells and over boxes;
- `held_unknowns`: least squares with some unknowns held;
- `plane_fit`: the fit of the plane that all markers of an image lie on;
- `marker_record`: what all of them know of a marker.

Numba compiles a kernel when its module is imported for the first time (`skyherd.jobs.compilation`). Importing
takes half a second, so that each module is imported by `fitting.compiled` when the first image, or the first
marker, is seen that needs it.

Numba compiles a kernel again when its own file changes, and not when a part or a constant that it imports
does. After a change to those, delete `__pycache__`.

Every kernel takes one marker after another and adds up in a fixed order, on the thread that calls it, so that
the same pixels give the same bytes. It holds no lock of Python's.
"""
