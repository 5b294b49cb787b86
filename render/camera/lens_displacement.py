"""Lens displacement of each pixel, in the form that the compiled drawing reads."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class LensField:
    """Undistortion map of the pixels of an image.

    Attributes:
        fields: (6, H W) displacements along u and v, px, and the derivatives of the undistorted by the
            distorted position: du/du, du/dv, dv/du, dv/dv.
    """

    fields: npt.NDArray[np.float32]
