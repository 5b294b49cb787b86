"""What the photometric detector has estimated about one unit's images, kept from image to image."""

from dataclasses import dataclass, field

from skyherd.vision.photometric.fitting.correlated_noise import PooledRatios
from skyherd.vision.photometric.fitting.fit_result import FitResults, weighted_median
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.tracks import Tracks, no_tracks
from skyherd.vision.photometric.unknown_blur import usual_sigma_px, with_usual_blur

LEARNING_RATE = 0.2
"""Share by which blur, noise and print move towards what an image shows. Chosen: an average over about five
images; a larger rate passes on more of each image's error, a smaller one follows a refocused lens more
slowly."""


@dataclass
class ImageEstimates:
    """What the detector has estimated about one unit's images so far.

    Attributes:
        sigma_px: usual standard deviation of the blur, lens and pixel together; None until markers have been
            seen.
        noise: standard deviation of a pixel, grey levels; None until then.
        contrast: usual difference of white and black of markers, grey levels; None until then.
        print_contrast: usual print contrast of markers, `(white - black) / white`; None until then.
        plane: that the markers lie on.
        tracks: the markers being followed.
        unsearched: number of images since the whole image was searched.
        first_looks: number of searches since the last that had a second look.
        is_second_look_worth_it: whether that second look found a marker.
        ratios: of the markers' variances to those that independent noise would give.
    """

    sigma_px: float | None = None
    noise: float | None = None
    contrast: float | None = None
    print_contrast: float | None = None
    plane: Plane = field(default_factory=Plane)
    tracks: Tracks = field(default_factory=no_tracks)
    unsearched: int = 0
    first_looks: int = 0
    is_second_look_worth_it: bool = True
    ratios: PooledRatios = field(default_factory=PooledRatios)

    def learn(self, found: FitResults, time_s: float) -> None:
        """Take in what an image taken at `time_s` showed: blur, noise, print, and the markers to follow."""
        sigmas_px = found.sigmas_px
        if len(found.ids):
            sigma_px, noise = usual_sigma_px(found), weighted_median(found.noise_stds, found.pixels)
            self.sigma_px = _moved_towards(sigma_px, self.sigma_px)
            self.noise = _moved_towards(noise, self.noise)
            contrast = weighted_median(found.contrasts, found.pixels)
            self.contrast = _moved_towards(contrast, self.contrast)
            print_contrast = weighted_median(found.print_contrasts(), found.pixels)
            self.print_contrast = _moved_towards(print_contrast, self.print_contrast)
            self.ratios = self.ratios.updated(found.variance_ratios, found.boxes)
            sigmas_px = with_usual_blur(found)
            sigmas_px[sigmas_px == sigma_px] = self.sigma_px
        self.tracks = self.tracks.updated(time_s, found.ids, found.homographies, sigmas_px)


def _moved_towards(value: float, before: float | None) -> float:
    """What was known before, moved by `LEARNING_RATE` of the difference, or the value itself."""
    return value if before is None else before + LEARNING_RATE * (value - before)
