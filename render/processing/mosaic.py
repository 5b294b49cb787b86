"""Bayer colour filter array and demosaicing.

Even rows have red and green filters, odd rows green and blue ones. White balance multiplies the signals of
red and blue pixels by g_red and g_blue. A grey scene becomes grey, and the noise of these pixels increases. A
filter transmits s / g, so that a pixel with signal s after white balance and factor g has

    y = s + sqrt(g² noise² + g shot s) ε.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError

Demosaic = Literal["none", "bilinear", "edge-aware"]
"""Demosaicing method: `none` for a sensor without filters, `bilinear`, or `edge-aware`, which interpolates
along edges, as most cameras do."""

CODES = {"bilinear": cv2.COLOR_BayerRGGB2BGR, "edge-aware": cv2.COLOR_BayerRGGB2BGR_EA}
"""OpenCV's code of each method, for red and green in the first row."""

SENSITIVITY_RANGE = (1.0, 4.0)
"""Range of white balance factors. *Chosen*: real cameras have 1 to 3, since green filters transmit the most
light."""


@dataclass(frozen=True)
class Mosaic:
    """Colour filter array of a sensor, and its demosaicing.

    Attributes:
        demosaic: demosaicing method; `none` for a sensor without filters.
        red_gain: white balance factor of red pixels.
        blue_gain: white balance factor of blue pixels.

    Raises:
        InputError: the method is unknown, or a factor is out of range.
    """

    demosaic: Demosaic = "none"
    red_gain: float = 1.0
    blue_gain: float = 1.0

    def __post_init__(self) -> None:
        if self.demosaic != "none" and self.demosaic not in CODES:
            raise InputError("demosaic", repr(self.demosaic), f"one of none, {', '.join(CODES)}")
        low, high = SENSITIVITY_RANGE
        if not (low <= self.red_gain <= high and low <= self.blue_gain <= high):
            allowed = f"each from {low:g} to {high:g}"
            raise InputError("white balance", f"red {self.red_gain}, blue {self.blue_gain}", allowed)

    @property
    def on(self) -> bool:
        """True for a sensor with filters."""
        return self.demosaic != "none"

    @property
    def information(self) -> float:
        """Fisher information relative to a sensor without filters, for noise independent of light.

        `1/2 + 1/4 g_red⁻² + 1/4 g_blue⁻²`, the mean of the pixels' inverse variances; 1 without filters.
        """
        return (2.0 + self.red_gain**-2.0 + self.blue_gain**-2.0) / 4.0 if self.on else 1.0

    def gains(self, height: int, width: int) -> npt.NDArray[np.float32]:
        """Return the white balance factor g (height, width) of each pixel."""
        gains = np.ones((height, width), dtype=np.float32)
        gains[0::2, 0::2], gains[1::2, 1::2] = self.red_gain, self.blue_gain
        return gains

    def interpolate(self, raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """Return the BGR image (height, width, 3) of a mosaic (height, width); unchanged without filters."""
        if not self.on:
            return raw
        return np.asarray(cv2.demosaicing(raw, CODES[self.demosaic]), dtype=np.uint16)


NO_MOSAIC = Mosaic()
"""Sensor without colour filters."""
