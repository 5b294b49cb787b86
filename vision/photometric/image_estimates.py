"""What the photometric detector has estimated about one unit's images, kept from image to image."""

from dataclasses import dataclass, field

from skyherd.vision.photometric.fitting.correlated_noise import PooledRatios
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.photometric.tracks import Tracks, no_tracks


@dataclass
class ImageEstimates:
    """What the detector has estimated about one unit's images so far.

    Attributes:
        sigma_px: usual standard deviation of the blur, lens and pixel together; None until markers have been
            seen.
        noise: standard deviation of a pixel, grey levels; None until markers have been seen.
        plane: that the markers lie on.
        tracks: the markers being followed.
        unsearched: number of images since the whole image was searched.
        first_looks: number of searches since the last that had a second look.
        is_second_look_worth_it: whether that second look found a marker.
        ratios: of the markers' variances to those that independent noise would give.
    """

    sigma_px: float | None = None
    noise: float | None = None
    plane: Plane = field(default_factory=Plane)
    tracks: Tracks = field(default_factory=no_tracks)
    unsearched: int = 0
    first_looks: int = 0
    is_second_look_worth_it: bool = True
    ratios: PooledRatios = field(default_factory=PooledRatios)
