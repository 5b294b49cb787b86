"""The sensor's colour filters, and what is interpolated between them.

Filters lie in fours, after Bayer: red and green in even rows, green and blue in odd ones. White balance
multiplies what red and blue pixels give by g_red and g_blue, which makes a grey scene grey and their noise
stronger: a pixel with the signal s (after white balance) and the factor g has

    y = s + sqrt(g² noise² + g shot s) ε,

since the filter let only s / g through.
"""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError

Demosaic = Literal["none", "bilinear", "edge-aware"]
"""How missing colours are interpolated: linearly from the nearest pixels of that colour; or, as most cameras
do, along edges rather than across; with `none` there are no filters."""

CODES = {"bilinear": cv2.COLOR_BayerRGGB2BGR, "edge-aware": cv2.COLOR_BayerRGGB2BGR_EA}
"""OpenCV's number of each interpolation, for red and green in the first row."""

SENSITIVITY_RANGE = (1.0, 4.0)
"""Least and greatest factor of white balance. *Chosen*: in real cameras it is between 1 and 3, for green
filters let most light through."""


@dataclass(frozen=True)
class Mosaic:
    """A sensor with colour filters, and the interpolation between them.

    Attributes:
        demosaic: the interpolation; `none` for a sensor without filters.
        red_gain: factor of white balance on red pixels.
        blue_gain: the same of blue ones.

    Raises:
        InputError: there is no such interpolation, or a factor is out of range.
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
        """Return whether there are filters."""
        return self.demosaic != "none"

    @property
    def information(self) -> float:
        """Return share of what pixels without filters would tell under noise that does not depend on light.

        `1/2 + 1/4 g_red⁻² + 1/4 g_blue⁻²`, the mean of the pixels' inverse variances; 1 without filters.
        """
        return (2.0 + self.red_gain**-2.0 + self.blue_gain**-2.0) / 4.0 if self.on else 1.0

    def gains(self, height: int, width: int) -> npt.NDArray[np.float32]:
        """Factor g (height, width) of white balance on each pixel."""
        gains = np.ones((height, width), dtype=np.float32)
        gains[0::2, 0::2], gains[1::2, 1::2] = self.red_gain, self.blue_gain
        return gains

    def interpolate(self, raw: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        """Colours (height, width, 3), blue first, of a mosaic (height, width); without filters, as it is."""
        if not self.on:
            return raw
        return np.asarray(cv2.demosaicing(raw, CODES[self.demosaic]), dtype=np.uint16)


NO_MOSAIC = Mosaic()
"""A sensor without colour filters."""
