"""What a lens does to each pixel of an image: the form in which drawing takes it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.floating]
"""Floating-point numbers of either precision; drawing uses single."""


@dataclass(frozen=True)
class LensField:
    """From each pixel of an image to where it would be without the lens; all fields flattened (H W,).

    Attributes:
        shift_u: displacement along u, px.
        shift_v: displacement along v, px.
        slopes: derivatives of the place without the lens by the pixel: (du/du, du/dv, dv/du, dv/dv).
    """

    shift_u: Float
    shift_v: Float
    slopes: tuple[Float, Float, Float, Float]
