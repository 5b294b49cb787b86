"""What every detector is given: a grey image of 8 bits."""

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError

Image = npt.NDArray[np.uint8]


def check_grey(image: Image) -> Image:
    """The image, contiguous; InputError unless it is grey, (height, width), of 8 bits and not empty."""
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < 1:
        raise InputError("image", f"shape {image.shape}, {image.dtype}", "grey, (height, width), uint8")
    return np.ascontiguousarray(image)
