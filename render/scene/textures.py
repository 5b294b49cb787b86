"""Periodic ground textures in grey levels: concrete, tiles, or a picture."""

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array

PERIOD = 2048
"""Samples along a side of a texture. *Chosen*: 2 cm per sample for concrete with a period of 40 m; twice as
many take four times the memory and time."""

SLABS = 8
"""Tiles along a period, of 256 samples each. *Chosen*: no repetition shows in a usual view."""

JOINT = 0.03
"""Width of the joints, relative to a tile. *Chosen*: usual for large floor tiles; wider joints are stronger
edges."""

JOINT_CONTRAST = 4
"""Contrast of the joints below the mean, in standard deviations of the tiles. *Chosen*: darker than any
tile."""

LONGEST_WAVES = 6
"""Spatial frequency up to which concrete has no content, cycles per period. *Chosen*: lower ones look like
uneven light, and repeat visibly."""


def concrete_spectrum(seed: int, mean: float, contrast: float) -> npt.NDArray[np.complex128]:
    """Return the spectrum (PERIOD, PERIOD // 2 + 1), as of `rfft2`, of noise with an amplitude of 1/f.

    Args:
        seed: seed of the noise.
        mean: mean grey level.
        contrast: standard deviation, grey levels.
    """
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft2(rng.standard_normal((PERIOD, PERIOD)))
    fy, fx = np.fft.fftfreq(PERIOD)[:, None] * PERIOD, np.fft.rfftfreq(PERIOD)[None, :] * PERIOD
    radius = np.hypot(fy, fx)
    spectrum *= (radius > LONGEST_WAVES) / np.maximum(radius, 1.0)
    # Parseval's theorem; all columns but the first and the last stand for two of the whole spectrum.
    squares = (spectrum.real**2 + spectrum.imag**2).sum(axis=0)
    spectrum *= contrast * PERIOD**2 / np.sqrt(2 * squares.sum() - squares[0] - squares[-1])
    spectrum[0, 0] = mean * PERIOD**2
    return spectrum


def tiles(seed: int, mean: float, contrast: float) -> Array:
    """Return square tiles (PERIOD, PERIOD) of random grey, SLABS per period, with dark joints.

    Args:
        seed: seed of the tiles' grey levels.
        mean: mean grey level.
        contrast: standard deviation between tiles. Joints are `JOINT_CONTRAST` times that below the mean.
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
        InputError: the image is not a grey image of 8 bits, or smaller than 2x2.
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
