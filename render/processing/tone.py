"""Gamma and contrast: from the sensor's signal, which is in proportion to light, to grey levels.

For a signal x from 0 to 1,

    y = (1 - s) x^(1/γ) + s S(x^(1/γ)),      S(t) = 3 t² - 2 t³,

with γ the gamma and s the strength of a curve that makes middle grey steeper and shadows and lights flatter.
"""

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

RAW_STEPS = 256
"""Steps of the raw signal for each grey level. *Chosen*: 16 bits in all, as OpenCV's demosaicing takes them;
rounding to them is far below any noise."""

RAW_LEVELS = 2**16
"""Values that a raw signal of 16 bits has."""

WHITE = 255.0
"""Grey level of full light in 8 bits."""


def raw_signal(light: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """Return a signal of 16 bits, `RAW_STEPS` a grey level, of light in grey levels; cut to 0-255."""
    scaled = np.clip(light, 0.0, WHITE) * np.float32(RAW_STEPS)
    return np.asarray(np.rint(scaled), dtype=np.uint16)


def tone(level: npt.ArrayLike, gamma: float, s_curve: float) -> npt.NDArray[np.float64]:
    """Return grey levels (...) from 0 to 255 that the curve makes of others: the law above."""
    t = (np.asarray(level, dtype=float) / WHITE) ** (1.0 / gamma)
    return np.asarray(WHITE * ((1 - s_curve) * t + s_curve * t * t * (3 - 2 * t)))


def luma(raw: npt.NDArray[np.uint16], gamma: float, s_curve: float) -> npt.NDArray[np.float32]:
    """Return the luma (height, width), in grey levels, of a raw signal of one colour or three, blue first.

    Each colour goes through the curve; then `Y = 0.299 R + 0.587 G + 0.114 B`, as JPEG, video and OpenCV have
    it.
    """
    toned = _curve(gamma, s_curve).take(raw)
    return toned if toned.ndim == 2 else np.asarray(cv2.cvtColor(toned, cv2.COLOR_BGR2GRAY))


@lru_cache(maxsize=16)
def _curve(gamma: float, s_curve: float) -> npt.NDArray[np.float32]:
    """Return the curve at each raw value (65536,); those above 255 grey levels never occur."""
    levels = np.minimum(np.arange(RAW_LEVELS) / RAW_STEPS, WHITE)
    curve = tone(levels, gamma, s_curve).astype(np.float32)
    curve.setflags(write=False)
    return curve
