"""Denoising and sharpening of the luma, which correlate the noise of neighbouring pixels."""

import cv2
import numpy as np
import numpy.typing as npt

Luma = npt.NDArray[np.float32]
"""Unrounded grey levels (height, width)."""

WINDOW_PX, REACH_PX = 5, 1.5
"""Window width of denoising, and standard deviation s of its spatial weights, px. *Chosen*: small, as in the
hardware of cameras; larger windows cost more."""


def denoise(image: Luma, strength: float) -> Luma:
    """Apply a bilateral filter.

        y(p) = Σ_q w(p, q) x(q) / Σ_q w(p, q),   w = exp(-|p - q|² / 2 s² - (x(p) - x(q))² / 2 d²)

    Args:
        image: x, grey levels (height, width).
        strength: d, grey levels; much higher edges stay sharp. With 0 the image is returned unchanged.
    """
    if not strength:
        return image
    return np.asarray(cv2.bilateralFilter(image, WINDOW_PX, strength, REACH_PX), dtype=np.float32)


def sharpen(image: Luma, amount: float, radius_px: float) -> Luma:
    """Apply an unsharp mask, `y = x + a (x - G x)`, where G is a Gaussian blur.

    Args:
        image: x, grey levels (height, width).
        amount: a; with 0 the image is returned unchanged.
        radius_px: standard deviation of G, px.
    """
    if not amount:
        return image
    soft = cv2.GaussianBlur(image, (0, 0), radius_px)
    return np.asarray(cv2.addWeighted(image, 1 + amount, soft, -amount, 0.0), dtype=np.float32)
