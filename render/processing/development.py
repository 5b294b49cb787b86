"""All that a camera's processing is set to, and the steps one after the other.

JPEG and video come after them, in `skyherd.render.sensor`: they take images of 8 bits.
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
"""What the pixels gathered, noise and all, in grey levels, (height, width)."""


BOUNDS = {
    "gamma": (0.2, 5.0),
    "s_curve": (0.0, 1.0),
    "denoise": (0.0, 255.0),
    "sharpen": (0.0, 5.0),
    "sharpen_px": (0.3, 10.0),
    "h264_crf": (0, 51),
}
"""Least and greatest value of each setting that is a number. *Chosen* beyond what any camera does; that of
the video is *derived*: x264 has no others."""


@dataclass(frozen=True)
class Processing:
    """A camera's processing; everything is off by default, and each part by its neutral value.

    Attributes:
        mosaic: colour filters and their interpolation.
        gamma: γ of the tone curve; 1 for a signal in proportion to light.
        s_curve: strength of the curve that adds contrast to the middle, 0 to 1.
        denoise: grey levels up to which differences of neighbours are taken for noise; 0 for none.
        sharpen: amount of the unsharp mask; 0 for none.
        sharpen_px: standard deviation of its blur.
        h264_crf: constant rate factor, 0 to 51, of a video that images go through; None for none.

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
        """Return whether anything is done to the signal before it is rounded to 8 bits."""
        toned = self.gamma != 1 or self.s_curve
        return bool(self.mosaic.on or toned or self.denoise or self.sharpen)

    def develop(self, light: Light) -> Image:
        """Make an image of 8 bits of what the pixels gathered: all steps before JPEG and video."""
        image = luma(self.mosaic.interpolate(raw_signal(light)), self.gamma, self.s_curve)
        image = sharpen(denoise(image, self.denoise), self.sharpen, self.sharpen_px)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)


UNPROCESSED = Processing()
"""A camera that gives what its sensor gathered."""
