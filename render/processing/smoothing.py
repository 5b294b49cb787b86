"""Denoising and sharpening of the luma, by which errors of neighbouring pixels depend on each other."""

import cv2
import numpy as np
import numpy.typing as npt

Luma = npt.NDArray[np.float32]
"""Grey levels (height, width) before they are rounded."""

WINDOW_PX, REACH_PX = 5, 1.5
"""Width of the window over which denoising averages, px, and the standard deviation s of its weights by
distance. *Chosen*: as small as the hardware of cameras has them; larger ones cost more."""


def denoise(image: Luma, strength: float) -> Luma:
    """Apply a bilateral filter: the mean over a window of pixels whose grey is like that of the middle one.

        y(p) = Σ_q w(p, q) x(q) / Σ_q w(p, q),   w = exp(-|p - q|² / 2 s² - (x(p) - x(q))² / 2 d²)

    Args:
        image: x, grey levels (height, width).
        strength: d, grey levels; edges that are much higher stay sharp. With 0 the image comes back.
    """
    if not strength:
        return image
    return np.asarray(cv2.bilateralFilter(image, WINDOW_PX, strength, REACH_PX), dtype=np.float32)


def sharpen(image: Luma, amount: float, radius_px: float) -> Luma:
    """Apply an unsharp mask `y = x + a (x - G x)`, with G a Gaussian blur; edges get bright and dark rims.

    Args:
        image: x, grey levels (height, width).
        amount: a; with 0 the image comes back.
        radius_px: standard deviation of G, px.
    """
    if not amount:
        return image
    soft = cv2.GaussianBlur(image, (0, 0), radius_px)
    return np.asarray(cv2.addWeighted(image, 1 + amount, soft, -amount, 0.0), dtype=np.float32)
