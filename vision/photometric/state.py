"""State of one camera: what the detector has estimated of its images so far."""

from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.messages import Quality
from skyherd.vision.photometric.fitting.correlated_noise import PooledRatios
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.refine import usual_sigma_px, with_usual_blur
from skyherd.vision.photometric.tracks import ShownMarkers, Tracks, no_tracks

LEARNING_RATE = 0.2
"""Share by which blur, noise and print move towards the estimates of a new image. Chosen: an average over
about five images; a larger rate passes on more of each image's error, a smaller one follows a refocused lens
more slowly."""


@dataclass(frozen=True)
class CameraState:
    """Estimates of one camera's images, kept from image to image.

    Attributes:
        sigma_px: usual standard deviation of the blur, lens and pixel together; None before the first marker.
        noise: standard deviation of a pixel, grey levels; None before the first marker.
        contrast: usual difference of white and black of markers, grey levels; None before the first marker.
        print_contrast: usual `(white - black) / white` of markers; None before the first marker.
        plane: common plane of the markers.
        tracks: the markers being followed.
        unsearched: images since the last search of a whole image.
        parts: parts of the next search that a `DeferringDetector` has done.
        searches: searches since the last fallback search.
        is_fallback_useful: whether that fallback search found a marker.
        ratios: of the markers' variances to those that independent noise would give.
    """

    sigma_px: float | None = None
    noise: float | None = None
    contrast: float | None = None
    print_contrast: float | None = None
    plane: Plane = field(default_factory=Plane)
    tracks: Tracks = field(default_factory=no_tracks)
    unsearched: int = 0
    parts: int = 0
    searches: int = 0
    is_fallback_useful: bool = True
    ratios: PooledRatios = field(default_factory=PooledRatios)

    def learned(self, found: FitResults, plane: Plane, time_s: float) -> "CameraState":
        """Return the state after an image taken at `time_s` with the markers `found` on `plane`.

        Only photometric measurements change the estimates of blur, noise and print. All markers are followed.
        """
        sigmas_px = found.sigmas_px
        state = replace(self, plane=plane)
        rows = found.qualities == Quality.PHOTOMETRIC
        if rows.any():
            clean = found.take(rows)
            usual_px = usual_sigma_px(clean)
            sigma_px = _moved_towards(usual_px, self.sigma_px)
            state = replace(
                state,
                sigma_px=sigma_px,
                noise=_moved_towards(weighted_median(clean.noise_stds, clean.pixels), self.noise),
                contrast=_moved_towards(weighted_median(clean.contrasts, clean.pixels), self.contrast),
                print_contrast=_moved_towards(
                    weighted_median(clean.print_contrasts(), clean.pixels), self.print_contrast
                ),
                ratios=self.ratios.updated(clean.variance_ratios, clean.boxes),
            )
            sigmas_px = with_usual_blur(found, usual_px)
            sigmas_px = np.where(sigmas_px == usual_px, sigma_px, sigmas_px)
        shown = ShownMarkers(found.ids, found.homographies, sigmas_px, found.surroundings)
        return replace(state, tracks=self.tracks.updated(time_s, shown))


def _moved_towards(value: float, before: float | None) -> float:
    """Return the earlier estimate moved by `LEARNING_RATE` of the difference, or the value itself."""
    return value if before is None else before + LEARNING_RATE * (value - before)
