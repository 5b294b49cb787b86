"""The photometric detector: markers measured as precisely as the noise allows, and followed between images.

Each image passes through these stages.

1. *Follow*: markers of the unit's last image are fitted where they should be by now
   (`skyherd.vision.photometric.tracks`).
2. *Search*: the whole image is searched for dark quadrilaterals (`skyherd.vision.search`), in every tenth
   image, and at once when a followed marker is missing or none is known. Their cells are compared with all
   markers of the dictionary; nothing is refused for a doubtful bit yet.
3. *Fit*: the known pattern of each marker is fitted to the image's own pixels
   (`skyherd.vision.photometric.fit`); large markers in a shrunk image.
4. *Verify*: a fit counts only if it shows its marker's bits and leaves nothing but noise
   (`skyherd.vision.photometric.verify`). A marker that something seems to cover is fitted once more to its
   visible pixels (`skyherd.vision.photometric.occlusion`).
5. *Learn*: what a unit's images have in common (blur, noise, print contrast, the markers' plane) is estimated
   from the fits and used for the next image.
"""

from dataclasses import replace
from statistics import median

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, IntArray, to_complex, to_points
from skyherd.messages import Detections
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.fit import MAX_STEPS, MAX_STEPS_FROM_PREDICTION, USUAL_NOISE, image_middle
from skyherd.vision.photometric.fit_result import FitResults, no_fit_results
from skyherd.vision.photometric.image_estimates import START_SIGMA_PX, ImageEstimates
from skyherd.vision.photometric.local_homography import LocalHomographies
from skyherd.vision.photometric.plane import Plane
from skyherd.vision.photometric.scales import fit_all_sizes, fit_visible_all_sizes
from skyherd.vision.photometric.tracks import in_view
from skyherd.vision.photometric.verify import (
    FIRST_WRONG_BIT_SHARE,
    bits_are_right,
    image_noise,
    match_blur_and_print,
    may_be_occluded,
    residual_is_noise,
    verified,
)
from skyherd.vision.search.decode import DecodedQuads, decode_quads
from skyherd.vision.search.quads import find_quads

LEARNING_RATE = 0.2
"""Share by which blur and noise move towards what an image shows. Chosen: an average over about five images;
a larger rate passes on more of each image's error, a smaller one follows a refocused lens more slowly."""

BLUR_ROUNDS, BLUR_SETTLED = 5, 0.04
"""In the first image that shows markers, the blur is found by so many rounds of fitting at most, until its
logarithm changes by less than the second number. Chosen: an error of 4 % is within one `BLUR_STEP` of the
patterns, and the fits correct it."""

CORNER_SQUEEZE_ERROR_PX = 1.0
"""Accuracy of a squeeze that is computed from a quadrilateral's corners, px. Chosen: corners are found to
about a pixel. Within it, the plane's squeeze is the better start."""

MIN_NOISE = 0.3
"""Smallest noise, grey levels. Derived: rounding to whole grey levels has `sqrt(1 / 12)` = 0.29."""

MIN_MARKERS_FOR_NOISE = 3
"""Number of markers from which on their residuals estimate an image's noise better than the image does
itself.
Chosen: with fewer, a fit would be judged by its own residuals."""

OCCLUDED_NOISE_RATIO = 1.5
"""A marker that leaves more than this many times the camera's noise does not count for the noise and the
blur.
Chosen: more than `skyherd.vision.photometric.verify.NOISE_FACTOR`, so that a rising noise is followed."""

SEARCH_INTERVAL = 10
"""While all markers are followed, the whole image is searched in every image of this number. Chosen: a new
marker waits this long at most; a smaller value costs time, which the search takes most of."""


class PhotometricDetector:
    """Finds, fits, verifies and follows markers; implements `skyherd.vision.Detector`.

    Positions come with covariances that hold for the image at hand: residuals, not tables, give the noise. An
    id that is found twice in an image is left out.

    Args:
        dictionary: of the markers, such as `4X4_50`.
        following: whether markers are followed from one image of a unit to the next. If not, each image is
            searched as a whole; blur, noise and plane are still learned.

    Attributes:
        estimates: what has been learned of each unit's images, by unit id.

    Raises:
        InputError: there is no such dictionary.
    """

    def __init__(self, dictionary: str = "4X4_50", *, following: bool = True) -> None:
        self.dictionary, self.following = dictionary, following
        self.estimates: dict[int, ImageEstimates] = {}
        self._none = no_fit_results(dictionary)

    def detect(self, image: Image, *, time_s: float = 0.0, unit_id: int = 0) -> Detections:
        """Return the markers in a grey image (height, width) of 8 bits, in ascending order of id.

        Args:
            image: grey, (height, width), uint8.
            time_s: when it was taken; times that do not increase count as 1 s apart.
            unit_id: whose image it is; what is learned is kept for each unit apart.

        Raises:
            InputError: the image is not a grey one of 8 bits, or is empty.
        """
        image = check_grey(image)
        known = self.estimates.setdefault(unit_id, ImageEstimates())
        found, lost = self._follow(image, known, time_s)
        known.unsearched += 1
        if lost or not len(found.ids) or known.unsearched >= SEARCH_INTERVAL:
            found = _unambiguous(found.joined(self._search(image, known, found.homographies)))
            known.unsearched = 0
        if 2 * len(found.ids) < known.found:
            known, found = self._search_anew(image, unit_id, known, found)
        self._learn(known, found, time_s)
        return _detections(found, image, time_s, unit_id)

    def _search_anew(
        self, image: Image, unit_id: int, known: ImageEstimates, found: FitResults
    ) -> tuple[ImageEstimates, FitResults]:
        """Search without any estimates, and drop them if that finds more.

        Called when most markers are gone: lights and lenses change, so that the estimates may be wrong.
        """
        fresh = ImageEstimates()
        anew = _unambiguous(self._search(image, fresh, self._none.homographies))
        if len(anew.ids) <= len(found.ids):
            return known, found
        self.estimates[unit_id] = fresh
        return fresh, anew

    def _follow(self, image: Image, known: ImageEstimates, time_s: float) -> tuple[FitResults, bool]:
        """Markers found where they were predicted, and whether one is missing or has left the view."""
        homographies = known.tracks.predicted(time_s)
        here = in_view(homographies, image.shape)
        if not here.any():
            return self._none, False
        near = homographies.take(here)
        fits = self._fit(image, known, known.tracks.ids[here], near, MAX_STEPS_FROM_PREDICTION)
        fits, good = self._verified_or_visible(image, known, fits)
        return fits.take(good), not (here.all() and good.all())

    def _search(self, image: Image, known: ImageEstimates, followed: LocalHomographies) -> FitResults:
        """Verified markers anywhere in the image but where markers are followed already."""
        quads = find_quads(image)
        quads = quads[_elsewhere(quads, followed)]
        if known.sigma_px is None:
            self._find_blur(image, known, quads)
        fits, good = self._verified_or_visible(image, known, self._fit_quads(image, known, quads))
        return fits.take(good)

    def _verified_or_visible(
        self, image: Image, known: ImageEstimates, fits: FitResults
    ) -> tuple[FitResults, BoolArray]:
        """Fits, of covered markers those to their visible pixels, and which of them (N,) are verified."""
        noise = known.noise or _noise_of(fits, image)
        good = _verified(fits, known, noise, image)
        doubtful = np.flatnonzero(may_be_occluded(fits, noise))
        if doubtful.size:
            sigma_px, floor = known.sigma_px or START_SIGMA_PX, max(noise, MIN_NOISE)
            visible = fit_visible_all_sizes(
                image, self.dictionary, fits.take(doubtful), sigma_px, known.plane, floor
            )
            accepted = _verified(visible, known, noise, image) & residual_is_noise(visible, floor)
            fits, good = fits.put(doubtful[accepted], visible.take(accepted)), good.copy()
            good[doubtful[accepted]] = True
        return fits, good

    def _fit_quads(self, image: Image, known: ImageEstimates, quads_px: Array) -> FitResults:
        """Fits of the markers that quadrilaterals (N, 4, 2) most resemble."""
        sigma_px = known.sigma_px or START_SIGMA_PX
        decoded = _best_of_each(decode_quads(image, quads_px, self.dictionary, sigma_px))
        if not decoded.ids.size:
            return self._none
        homographies = _on_plane(
            LocalHomographies.of_corners(decoded.corners_px), known.plane, image_middle(image)
        )
        return self._fit(image, known, decoded.ids, homographies)

    def _fit(
        self,
        image: Image,
        known: ImageEstimates,
        ids: IntArray,
        homographies: LocalHomographies,
        max_steps: int = MAX_STEPS,
    ) -> FitResults:
        """Fits with what is known; the plane that they give is kept if any of them shows its bits."""
        sigma_px = known.sigma_px or START_SIGMA_PX
        noise = max(known.noise or USUAL_NOISE, MIN_NOISE)
        fits, plane = fit_all_sizes(
            image, self.dictionary, ids, homographies, sigma_px, known.plane, noise, max_steps
        )
        if plane != known.plane and bits_are_right(fits).any():
            known.plane = plane
        return fits

    def _find_blur(self, image: Image, known: ImageEstimates, quads_px: Array) -> None:
        """Fit repeatedly with the blur that the last fits found, until it changes no more."""
        for _ in range(BLUR_ROUNDS):
            found = self._fit_quads(image, known, quads_px)
            found = found.take(_first_look(found, image))
            if not len(found.ids):
                return
            log_error = median(found.log_blurs.tolist())
            known.adjust_blur(log_error, 1.0)
            if abs(log_error) < BLUR_SETTLED:
                return

    def _learn(self, known: ImageEstimates, found: FitResults, time_s: float) -> None:
        """Update blur, noise and print contrast and, if markers are followed, the tracks."""
        known.found = len(found.ids)
        limit = np.inf if known.noise is None else OCCLUDED_NOISE_RATIO * known.noise
        usual = found.take(found.noise_stds < limit)
        if len(usual.ids):
            log_error, noise, known.print_contrast = (
                median(values.tolist())
                for values in (usual.log_blurs, usual.noise_stds, usual.print_contrasts())
            )
            known.adjust_blur(log_error, LEARNING_RATE)
            before = noise if known.noise is None else known.noise
            known.noise = before + LEARNING_RATE * (noise - before)
        if self.following:
            known.tracks = known.tracks.updated(time_s, found.ids, found.homographies)


def _on_plane(homographies: LocalHomographies, plane: Plane, middle: complex) -> LocalHomographies:
    """Homographies with the plane's squeezes, where their own agree to the accuracy of corners."""
    squeezes = plane.squeezes(homographies.centers - middle) * homographies.arms.conj()
    near = np.abs(squeezes - homographies.squeezes) < CORNER_SQUEEZE_ERROR_PX
    return replace(homographies, squeezes=np.where(near, squeezes, homographies.squeezes))


def _first_look(fits: FitResults, image: Image) -> BoolArray:
    """Which fits (N,) show their marker when nothing but the image says how large its noise is."""
    return verified(fits, max(image_noise(image), MIN_NOISE), FIRST_WRONG_BIT_SHARE)


def _verified(fits: FitResults, known: ImageEstimates, noise: float, image: Image) -> BoolArray:
    """Which fits (N,) show their marker, by the unit's estimates or, without any, at a first look as well."""
    if known.noise is not None:
        return verified(fits, noise) & match_blur_and_print(fits, 0.0, known.print_contrast)
    return _first_look(fits, image) & verified(fits, noise)


def _noise_of(fits: FitResults, image: Image) -> float:
    """Noise of a unit without estimates, grey levels: of its markers if they are enough, or the image."""
    first = fits.noise_stds[_first_look(fits, image)]
    if first.size >= MIN_MARKERS_FOR_NOISE:
        return float(np.median(first))
    return max(image_noise(image), MIN_NOISE)


def _elsewhere(quads_px: Array, followed: LocalHomographies) -> BoolArray:
    """Which quadrilaterals (N, 4, 2) have their middle within no marker that is followed."""
    middles = to_complex(quads_px).mean(axis=1)
    distance = np.abs(middles[:, None] - followed.centers)
    return np.asarray((distance > followed.sides_px() / 2).all(axis=1))


def _best_of_each(decoded: DecodedQuads) -> DecodedQuads:
    """Of quadrilaterals for one marker in one place, such as both boundaries of its border, the likeliest."""
    middles = to_complex(decoded.corners_px).mean(axis=1)
    sides = LocalHomographies.of_corners(decoded.corners_px).sides_px()
    twins = np.abs(middles[:, None] - middles) < sides / 2
    twins &= decoded.ids[:, None] == decoded.ids
    kept = np.ones(middles.size, dtype=bool)
    for row in np.argsort(-decoded.correlations):
        if kept[row]:
            kept &= ~twins[:, row]
            kept[row] = True
    return decoded.take(kept)


def _unambiguous(fits: FitResults) -> FitResults:
    """The fits whose id was found once, in ascending order of id."""
    _, first, counts = np.unique(fits.ids, return_index=True, return_counts=True)
    return fits.take(first[counts == 1])


def _detections(found: FitResults, image: Image, time_s: float, unit_id: int) -> Detections:
    return Detections(
        unit_id=unit_id,
        time_s=time_s,
        image_size_px=np.array([image.shape[1], image.shape[0]]),
        ids=found.ids,
        centers_px=to_points(found.homographies.centers),
        headings_rad=found.homographies.headings_rad(),
        sides_px=found.homographies.sides_px(),
        corners_px=to_points(found.homographies.images(SQUARE_CORNERS)),
        covariances=found.covariances,
    )
