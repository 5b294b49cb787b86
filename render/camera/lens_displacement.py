"""Displacement of each pixel by a lens, in the form that drawing uses."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class LensField:
    """From each pixel of an image, flattened, to where it would be without the lens.

    Attributes:
        fields: (6, H W) displacements along u and along v, px, and the derivatives of the place without the
            lens by the pixel: du/du, du/dv, dv/du, dv/dv.
    """

    fields: npt.NDArray[np.float32]
