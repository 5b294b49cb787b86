"""What a lens does to each pixel of an image."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.floating]


@dataclass(frozen=True)
class LensField:
    """What a lens does to each pixel of an image, flattened (H W,).

    Attributes:
        shift_u: from where a pixel is to where it would be without the lens, px.
        shift_v: the same along v.
        slopes: derivatives of the place without the lens: (du/du, du/dv, dv/du, dv/dv).
    """

    shift_u: Float
    shift_v: Float
    slopes: tuple[Float, Float, Float, Float]
