"""What the kernels know of a marker: a record of its geometry and its appearance."""

import numpy as np
from numba import from_dtype

from skyherd.jobs.compilation import readonly

MARKER = np.dtype(
    [
        ("center", complex),
        ("x_axis", complex),
        ("y_axis", complex),
        ("perspective", complex),
        ("keystone", complex),
        ("anisotropy", complex),
        ("limit", float),
        ("strip", float),
        ("height_px", float),
        ("sigma", float),
        ("black_ratio", float),
        ("half_card", float),
        ("x_stretch", float),
        ("y_stretch", float),
    ]
)
"""Record of a marker for the kernels; lengths are in marker sides unless a unit is given.

- `center`, px, and the axes X and Y and the `perspective`, 1/px, of `LocalHomographies.axes`;
- `keystone`, by how much the marker's image shrinks towards its points, and `anisotropy`, by how much round
  blur differs along its directions (`LocalHomographies.blur_anisotropies`); both are 0 where blur is drawn as
  if the marker were seen from straight above;
- `limit`, up to which marker coordinates pixels are read; `strip`, the same for the affine part of the
  homography, wide enough for what a horizon adds; `height_px`, half the height of the strips' common part;
- `sigma`, the blur's standard deviation, and its standard deviations along x and y over `sigma`;
- `black_ratio`, black level over contrast;
- `half_card`, the distance of the card's edge from the centre, infinite where no ground is to be seen.
"""

MARKERS = readonly(from_dtype(MARKER), 1)
"""Type of an array of such records."""
