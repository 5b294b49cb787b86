"""Compiled loops over the pixels that flat shapes touch.

- `pixels`: which pixels a shape touches, where on it they lie, and how sharp it is there;
- `lattices`: grids of grey cells, such as marker cards;
- `discs`: discs.

Both kernels take one shape after another, each over those before it. They go through its image rows, and in
each row through the pixels within a margin of the shape's outline. Nothing is sampled, filtered or kept from
one image to the next. NumPy has the same formulas, in double precision, in
`tests/helpers/drawing_reference.py`.

Numba compiles a kernel when its module is imported for the first time (`skyherd.jobs.compilation`);
`skyherd.render.paint` imports it with the first shape that is drawn.
"""
