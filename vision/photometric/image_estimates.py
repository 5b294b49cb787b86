"""What the photometric detector has estimated about one unit's images, kept from image to image."""

import math
from dataclasses import dataclass, field

from skyherd.markers.blur_model import total_sigma_px
from skyherd.vision.photometric.plane import Plane
from skyherd.vision.photometric.tracks import Tracks, no_tracks

START_SIGMA_PX = total_sigma_px(0.8)
"""Blur assumed before any marker was seen, standard deviation of lens and pixel together, px. Chosen: a lens
of 0.8 px, as in the accuracy tables; the first image with markers replaces it."""

SIGMA_LIMITS_PX = (0.35, 4.0)
"""Limits of the blur that is learned, standard deviation, px. Chosen: the pixel alone has 0.29, and 4 px is
more than markers of 30 px can be read with."""

MAX_LOG_BLUR_STEP = 0.4
"""Largest change of the blur's logarithm at a time. Chosen: the model is linear in it, so that a larger step
is not reliable."""


@dataclass
class ImageEstimates:
    """What the detector has estimated about one unit's images so far.

    Attributes:
        sigma_px: standard deviation of the blur, lens and pixel together; None until markers have been seen.
        noise: standard deviation of a pixel, grey levels; None until markers have been seen.
        print_contrast: of the unit's markers, `(white - black) / white`.
        plane: that the markers lie on.
        tracks: the markers being followed.
        unsearched: number of images since the whole image was searched.
        found: number of markers in the last image.
    """

    sigma_px: float | None = None
    noise: float | None = None
    print_contrast: float = 0.0
    plane: Plane = field(default_factory=Plane)
    tracks: Tracks = field(default_factory=no_tracks)
    unsearched: int = 0
    found: int = 0

    def adjust_blur(self, log_error: float, rate: float) -> None:
        """Move the blur by a share `rate` of its error, the logarithm of the true over the assumed blur."""
        step = rate * min(max(log_error, -MAX_LOG_BLUR_STEP), MAX_LOG_BLUR_STEP)
        sigma_px = (self.sigma_px or START_SIGMA_PX) * math.exp(step)
        self.sigma_px = min(max(sigma_px, SIGMA_LIMITS_PX[0]), SIGMA_LIMITS_PX[1])
