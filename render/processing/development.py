"""Settings of a camera's image processing, and its steps up to rounding to 8 bits.

JPEG and video compression follow in `skyherd.render.sensor`.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Image
from skyherd.render.processing.mosaic import NO_MOSAIC, Mosaic
from skyherd.render.processing.smoothing import denoise, sharpen
from skyherd.render.processing.tone import luma, raw_signal

Light = npt.NDArray[np.float32]
"""Sensor signal with noise, in grey levels, (height, width)."""


BOUNDS = {
    "gamma": (0.2, 5.0),
    "s_curve": (0.0, 1.0),
    "denoise": (0.0, 255.0),
    "sharpen": (0.0, 5.0),
    "sharpen_px": (0.3, 10.0),
    "h264_crf": (0, 51),
}
"""Range of each numeric setting. *Chosen*: wider than the settings of cameras. The range of `h264_crf` is
*defined* by x264."""


@dataclass(frozen=True)
class Processing:
    """Image processing of a camera; each step is off by default.

    Attributes:
        mosaic: colour filter array and demosaicing.
        gamma: γ of the tone curve; 1 for a linear response.
        s_curve: strength, 0 to 1, of the curve that increases contrast at middle grey.
        denoise: range parameter of the bilateral filter, grey levels; 0 for none.
        sharpen: amount of the unsharp mask; 0 for none.
        sharpen_px: standard deviation of the unsharp mask's blur.
        h264_crf: constant rate factor, 0 to 51, of H.264 compression; None for none.

    Raises:
        InputError: a value is out of range.
    """

    mosaic: Mosaic = NO_MOSAIC
    gamma: float = 1.0
    s_curve: float = 0.0
    denoise: float = 0.0
    sharpen: float = 0.0
    sharpen_px: float = 1.0
    h264_crf: int | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in BOUNDS.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                none = ", or none" if isinstance(high, int) else ""
                raise InputError(name, f"{value:g}", f"from {low:g} to {high:g}{none}")

    @property
    def develops(self) -> bool:
        """True if a step before the rounding to 8 bits is on."""
        toned = self.gamma != 1 or self.s_curve
        return bool(self.mosaic.on or toned or self.denoise or self.sharpen)

    def develop(self, light: Light) -> Image:
        """Return the image of 8 bits of a sensor signal: all steps before JPEG and video."""
        image = luma(self.mosaic.interpolate(raw_signal(light)), self.gamma, self.s_curve)
        image = sharpen(denoise(image, self.denoise), self.sharpen, self.sharpen_px)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


UNPROCESSED = Processing()
"""Camera without image processing."""
