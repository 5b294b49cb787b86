"""Textures of the ground as periodic arrays of grey levels: concrete, tiles, or a picture."""

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array

PERIOD = 2048
"""Samples of a texture along either side. *Chosen*: 2 cm a sample for concrete of 40 m; twice as many take
four times the memory and time."""

SLABS = 8
"""Tiles along a period. *Chosen*: enough that repetition does not show in a usual view; each has 256
samples."""

JOINT = 0.03
"""Width of the joints between tiles, in tiles. *Chosen*: as of large floor tiles; wider joints are stronger
edges."""

JOINT_CONTRAST = 4
"""By how many standard deviations of the tiles the joints are darker than the mean. *Chosen*: darker than any
tile."""

LONGEST_WAVES = 6
"""Waves of up to so many a period are left out of concrete. *Chosen*: such long ones would be uneven light
and no texture, and repeat visibly."""


def concrete(seed: int, mean: float, contrast: float) -> Array:
    """Noise (PERIOD, PERIOD) whose spectrum falls as 1/f; mean and standard deviation in grey levels."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal((PERIOD, PERIOD)))
    fy, fx = np.fft.fftfreq(PERIOD)[:, None] * PERIOD, np.fft.rfftfreq(PERIOD)[None, :] * PERIOD
    radius = np.hypot(fy, fx)
    spectrum *= radius > LONGEST_WAVES
    spectrum /= np.maximum(radius, 1.0)
    image = np.fft.irfft2(spectrum)
    return np.asarray(mean + image * (contrast / image.std()))


def tiles(seed: int, mean: float, contrast: float) -> Array:
    """Square tiles (PERIOD, PERIOD), SLABS a period, each a little lighter or darker, and dark joints.

    `contrast` is the standard deviation between tiles; joints are `JOINT_CONTRAST` times that darker than the
    mean.
    """
    rng = np.random.default_rng(seed)
    slab = PERIOD // SLABS
    levels = mean + contrast * rng.standard_normal((SLABS, SLABS))
    image = np.kron(levels, np.ones((slab, slab)))
    joint = np.zeros(PERIOD, dtype=bool)
    joint[np.arange(PERIOD) % slab < max(round(JOINT * slab), 1)] = True
    image[joint[:, None] | joint[None, :]] = mean - JOINT_CONTRAST * contrast
    return np.clip(image, 0, 255)


def picture(image: npt.NDArray[np.uint8]) -> Array:
    """Return a grey image (height, width), its upper edge to the north, as a texture (PERIOD, PERIOD).

    Raises:
        InputError: it is not a grey image of 8 bits.
    """
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < 2:
        raise InputError(
            "ground image", f"shape {image.shape}, {image.dtype}", "a grey image (height, width) of 8 bits"
        )
    shrinks = max(image.shape) > PERIOD
    resized = cv2.resize(
        image, (PERIOD, PERIOD), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    )
    return np.asarray(resized[::-1], dtype=float)
