"""Markers measured as well as the noise allows, and followed from image to image.

Markers seen before are fitted where they should be by now. The whole image is searched for others at set
intervals, and at once when a marker is lost or none is known. Every fit has to show its marker's bits and to
leave nothing but noise before it counts. What a camera's images have in common, its blur, its noise and the
plane that the markers lie on, is learned from the fits, for each unit.
"""

import math
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, IntArray, to_complex, to_points
from skyherd.markers.blur_model import total_sigma_px
from skyherd.messages import Detections
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.fit import FOLLOWED_ROUNDS, ROUNDS, USUAL_NOISE
from skyherd.vision.photometric.fit_result import Fits, no_fits
from skyherd.vision.photometric.local_homography import Shapes
from skyherd.vision.photometric.plane import Plane
from skyherd.vision.photometric.scales import fit_all_sizes, visible_all_sizes
from skyherd.vision.photometric.tracks import Tracks, in_view, no_tracks
from skyherd.vision.photometric.verify import (
    FIRST_SHARE,
    are_alike,
    bits_are_right,
    image_noise,
    leave_noise_only,
    may_be_covered,
    verified,
)
from skyherd.vision.search.decode import Candidates, decode_quads
from skyherd.vision.search.quads import find_quads

START_SIGMA_PX = total_sigma_px(0.8)
SIGMA_LIMITS_PX = (0.35, 4.0)
BLUR_RATE, BLUR_ROUNDS, BLUR_SETTLED = 0.2, 5, 0.04
"""A camera's blur is found in the first image that shows markers, to 4 %, and followed slowly from there."""

LARGEST_BLUR_CHANGE = 0.4
"""The blur's logarithm is changed by no more than this at a time."""

CORNERS_TELL_PX = 1.0
"""Squeezes of candidates are right to this."""

LEAST_NOISE = 0.3
"""Rounding to whole grey levels leaves as much in any image."""

WITNESSES = 3
"""So many markers tell an image's noise better than it does itself; fewer would judge in their own case."""

COVERED_NOISE = 1.5
"""A marker that leaves so many times the camera's noise tells none."""

SEARCH_INTERVAL = 10
"""While all markers are followed, the whole image is searched in every tenth."""


@dataclass
class Camera:
    """What is known of one unit's images.

    Attributes:
        sigma_px: blur of lens and pixel together; None until markers have been seen.
        noise: standard deviation of a pixel, grey levels; None likewise.
        print_contrast: of its markers.
        plane: that the markers lie on.
        tracks: markers being followed.
        unsearched: images since a whole one was searched.
        found: markers in the last image.
    """

    sigma_px: float | None = None
    noise: float | None = None
    print_contrast: float = 0.0
    plane: Plane = field(default_factory=Plane)
    tracks: Tracks = field(default_factory=no_tracks)
    unsearched: int = 0
    found: int = 0

    def blur(self, log_off: float, rate: float) -> None:
        """Move the blur by a share of what it is off by, in its logarithm."""
        step = rate * min(max(log_off, -LARGEST_BLUR_CHANGE), LARGEST_BLUR_CHANGE)
        sigma_px = (self.sigma_px or START_SIGMA_PX) * math.exp(step)
        self.sigma_px = min(max(sigma_px, SIGMA_LIMITS_PX[0]), SIGMA_LIMITS_PX[1])


class PhotometricDetector:
    """Finds, fits, verifies and follows markers.

    Args:
        dictionary: of the markers.
        following: whether markers are followed from one image of a unit to the next; if not, each image is
            searched whole.

    Attributes:
        cameras: what has been learned of each unit's images.
    """

    def __init__(self, dictionary: str = "4X4_50", *, following: bool = True) -> None:
        self.dictionary, self.following = dictionary, following
        self.cameras: dict[int, Camera] = {}
        self._none = no_fits(dictionary)

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Markers in a grey image (height, width) of 8 bits; an id found twice is left out as untrustworthy.

        Raises:
            InputError: the image is not a grey one of 8 bits.
        """
        image = check_grey(image)
        camera = self.cameras.setdefault(unit_id, Camera())
        found, lost = self._follow(image, camera, time_s)
        camera.unsearched += 1
        if lost or not len(found.ids) or camera.unsearched >= SEARCH_INTERVAL:
            found = _unambiguous(found.joined(self._search(image, camera, found.shapes)))
            camera.unsearched = 0
        if 2 * len(found.ids) < camera.found:
            camera, found = self._look_anew(image, unit_id, camera, found)
        self._learn(camera, found, time_s)
        return _detections(found, image, time_s, unit_id)

    def _look_anew(self, image: Image, unit_id: int, camera: Camera, found: Fits) -> tuple[Camera, Fits]:
        """When most markers are gone: lamps go on and lenses change, so that what was known may not hold."""
        fresh = Camera()
        anew = _unambiguous(self._search(image, fresh, self._none.shapes))
        if len(anew.ids) <= len(found.ids):
            return camera, found
        self.cameras[unit_id] = fresh
        return fresh, anew

    def _follow(self, image: Image, camera: Camera, time_s: float) -> tuple[Fits, bool]:
        """Markers still where they should be by now, and whether one is not, or should have left the view."""
        shapes = camera.tracks.predicted(time_s)
        here = in_view(shapes, image.shape)
        if not here.any():
            return self._none, False
        near = shapes.take(here)
        fits = self._fit(image, camera, camera.tracks.ids[here], near, FOLLOWED_ROUNDS)
        fits, good = self._shown(image, camera, fits)
        return fits.take(good), not (here.all() and good.all())

    def _search(self, image: Image, camera: Camera, known: Shapes) -> Fits:
        """Markers anywhere in the image but where they are known to be."""
        quads = find_quads(image)
        quads = quads[_elsewhere(quads, known)]
        if camera.sigma_px is None:
            self._find_blur(image, camera, quads)
        fits, good = self._shown(image, camera, self._candidates(image, camera, quads))
        return fits.take(good)

    def _shown(self, image: Image, camera: Camera, fits: Fits) -> tuple[Fits, BoolArray]:
        """The fits, by what is seen of their markers where these are covered, and which (N,) show theirs."""
        noise = camera.noise or _noise_of(fits, image)
        good = _verified(fits, camera, noise, image)
        doubtful = np.flatnonzero(may_be_covered(fits, noise))
        if doubtful.size:
            sigma_px, floor = camera.sigma_px or START_SIGMA_PX, max(noise, LEAST_NOISE)
            visible = visible_all_sizes(
                image, self.dictionary, fits.take(doubtful), sigma_px, camera.plane, floor
            )
            shown = _verified(visible, camera, noise, image) & leave_noise_only(visible, floor)
            fits, good = fits.put(doubtful[shown], visible.take(shown)), good.copy()
            good[doubtful[shown]] = True
        return fits, good

    def _candidates(self, image: Image, camera: Camera, quads_px: Array) -> Fits:
        """What quadrilaterals (N, 4, 2) most resemble, fitted."""
        sigma_px = camera.sigma_px or START_SIGMA_PX
        candidates = _best_of_each(decode_quads(image, quads_px, self.dictionary, sigma_px))
        if not candidates.ids.size:
            return self._none
        shapes = _on_plane(Shapes.of_corners(candidates.corners_px), camera.plane, image.shape)
        return self._fit(image, camera, candidates.ids, shapes)

    def _fit(self, image: Image, camera: Camera, ids: IntArray, shapes: Shapes, rounds: int = ROUNDS) -> Fits:
        sigma_px = camera.sigma_px or START_SIGMA_PX
        noise = max(camera.noise or USUAL_NOISE, LEAST_NOISE)
        fits, plane = fit_all_sizes(
            image, self.dictionary, ids, shapes, sigma_px, camera.plane, noise, rounds
        )
        if plane != camera.plane and bits_are_right(fits).any():
            camera.plane = plane
        return fits

    def _find_blur(self, image: Image, camera: Camera, quads_px: Array) -> None:
        """Fit with the blur that the fits find, until it is found right."""
        for _ in range(BLUR_ROUNDS):
            found = self._candidates(image, camera, quads_px)
            found = found.take(_seem_right(found, image))
            if not len(found.ids):
                return
            off = median(found.log_blurs.tolist())
            camera.blur(off, 1.0)
            if abs(off) < BLUR_SETTLED:
                return

    def _learn(self, camera: Camera, found: Fits, time_s: float) -> None:
        """Take over the blur, the noise and, if they are to be followed, the places of the markers found."""
        camera.found = len(found.ids)
        told = found if camera.noise is None else found.take(found.noises < COVERED_NOISE * camera.noise)
        if len(told.ids):
            off, noise, camera.print_contrast = (
                median(values.tolist()) for values in (told.log_blurs, told.noises, told.print_contrasts())
            )
            camera.blur(off, BLUR_RATE)
            before = noise if camera.noise is None else camera.noise
            camera.noise = before + BLUR_RATE * (noise - before)
        if self.following:
            camera.tracks = camera.tracks.seen(time_s, found.ids, found.shapes)


def _on_plane(shapes: Shapes, plane: Plane, image_shape: tuple[int, ...]) -> Shapes:
    """Shapes with the squeezes that the plane gives them, where their own are as near as corners can tell."""
    middle = complex(image_shape[1] - 1, image_shape[0] - 1) / 2
    squeezes = plane.squeezes(shapes.centers - middle) * shapes.arms.conj()
    near = np.abs(squeezes - shapes.squeezes) < CORNERS_TELL_PX
    return replace(shapes, squeezes=np.where(near, squeezes, shapes.squeezes))


def _seem_right(fits: Fits, image: Image) -> BoolArray:
    """Which fits (N,) show their marker at a first look, by what the image itself tells of its noise."""
    return verified(fits, max(image_noise(image), LEAST_NOISE), FIRST_SHARE)


def _verified(fits: Fits, camera: Camera, noise: float, image: Image) -> BoolArray:
    """Which fits (N,) show their marker."""
    if camera.noise is not None:
        return verified(fits, noise) & are_alike(fits, 0.0, camera.print_contrast)
    return _seem_right(fits, image) & verified(fits, noise)


def _noise_of(fits: Fits, image: Image) -> float:
    """Noise of a camera of which nothing is known, grey levels: the image tells it, but where markers do."""
    first = fits.noises[_seem_right(fits, image)]
    return float(np.median(first)) if first.size >= WITNESSES else max(image_noise(image), LEAST_NOISE)


def _elsewhere(quads_px: Array, known: Shapes) -> BoolArray:
    """Which quadrilaterals (N, 4, 2) have their middle within no known marker."""
    middles = to_complex(quads_px).mean(axis=1)
    distance = np.abs(middles[:, None] - known.centers)
    return np.asarray((distance > known.sides_px() / 2).all(axis=1))


def _best_of_each(candidates: Candidates) -> Candidates:
    """Of candidates for one marker in one place, such as the two boundaries of its border, the likeliest."""
    middles = to_complex(candidates.corners_px).mean(axis=1)
    sides = Shapes.of_corners(candidates.corners_px).sides_px()
    twins = np.abs(middles[:, None] - middles) < sides / 2
    twins &= candidates.ids[:, None] == candidates.ids
    kept = np.ones(middles.size, dtype=bool)
    for row in np.argsort(-candidates.likenesses):
        if kept[row]:
            kept &= ~twins[:, row]
            kept[row] = True
    return candidates.take(kept)


def _unambiguous(fits: Fits) -> Fits:
    """In order of id, those found once."""
    _, first, counts = np.unique(fits.ids, return_index=True, return_counts=True)
    return fits.take(first[counts == 1])


def _detections(found: Fits, image: Image, time_s: float, unit_id: int) -> Detections:
    return Detections(
        unit_id=unit_id,
        time_s=time_s,
        image_size_px=np.array([image.shape[1], image.shape[0]]),
        ids=found.ids,
        centers_px=to_points(found.shapes.centers),
        headings_rad=found.shapes.headings_rad(),
        sides_px=found.shapes.sides_px(),
        corners_px=to_points(found.shapes.images(SQUARE_CORNERS)),
        covariances=found.covariances,
    )
