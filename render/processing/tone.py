"""Tone curve: gamma and contrast, from the linear sensor signal to grey levels.

For a signal x from 0 to 1,

    y = (1 - s) x^(1/γ) + s S(x^(1/γ)),      S(t) = 3 t² - 2 t³,

where γ is the gamma and s the strength of an S-curve, which increases contrast at middle grey.
"""

from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

RAW_STEPS = 256
"""Raw signal steps per grey level. *Chosen*: 16 bits in total, the input of OpenCV's demosaicing. The
rounding error is far below any noise."""

RAW_LEVELS = 2**16
"""Number of values of a raw signal of 16 bits."""

WHITE = 255.0
"""Grey level of white in 8 bits."""


def raw_signal(light: npt.NDArray[np.float32]) -> npt.NDArray[np.uint16]:
    """Return the 16-bit signal, `RAW_STEPS` per grey level, of light in grey levels, clipped to 0-255."""
    scaled = np.clip(light, 0.0, WHITE) * np.float32(RAW_STEPS)
    return np.asarray(np.rint(scaled), dtype=np.uint16)


def tone(level: npt.ArrayLike, gamma: float, s_curve: float) -> npt.NDArray[np.float64]:
    """Return grey levels (...), 0 to 255, after the tone curve of the module's docstring."""
    t = (np.asarray(level, dtype=float) / WHITE) ** (1.0 / gamma)
    return np.asarray(WHITE * ((1 - s_curve) * t + s_curve * t * t * (3 - 2 * t)))


def luma(raw: npt.NDArray[np.uint16], gamma: float, s_curve: float) -> npt.NDArray[np.float32]:
    """Return the luma (height, width), in grey levels, of a raw signal of one channel or BGR.

    The curve is applied to each channel. Then `Y = 0.299 R + 0.587 G + 0.114 B`, as in JPEG, video and
    OpenCV.
    """
    toned = _curve(gamma, s_curve).take(raw)
    return toned if toned.ndim == 2 else np.asarray(cv2.cvtColor(toned, cv2.COLOR_BGR2GRAY))


@lru_cache(maxsize=16)
def _curve(gamma: float, s_curve: float) -> npt.NDArray[np.float32]:
    """Return the curve at each raw value (65536,); values above 255 grey levels do not occur."""
    levels = np.minimum(np.arange(RAW_LEVELS) / RAW_STEPS, WHITE)
    curve = tone(levels, gamma, s_curve).astype(np.float32)
    curve.setflags(write=False)
    return curve
