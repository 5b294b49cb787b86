"""Why markers were not detected: where the default detector loses each candidate, and by which limit.

The stages are those of the detector, and the results of its searches are taken as they are
(`PhotometricDetector.searches`). A candidate that was fitted is explained by the first test that its fit
fails, and by its log odds. A quadrilateral that resembles a marker and was not fitted is explained by its
wrong cells. Markers that no search can find are guessed (`guesses`), and fitted to find the test that they
would fail.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, IntArray, to_points
from skyherd.markers.dictionary import cells_per_side, code_distance, sides_of_corners
from skyherd.messages import Detections
from skyherd.vision.diagnosis.guesses import dark_patches, guess_markers
from skyherd.vision.diagnosis.places import first_of_each_place, on_detections
from skyherd.vision.diagnosis.reading import Named, Reading, depths, name_quads, read_markers
from skyherd.vision.diagnosis.reasons import (
    CERTAIN,
    Measured,
    Reason,
    Suspect,
    failed_test,
    find_reason,
)
from skyherd.vision.diagnosis.wording import WORDS, describe
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.candidates import SearchPass, may_be_cut
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.evidence.likelihood import marker_odds, min_log_odds
from skyherd.vision.photometric.fitting.fit_result import no_fit_results
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.measure import fit_alone
from skyherd.vision.photometric.verify import STRONG_DISTANCE, Quantity, verification_tests
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.edges import fit_edges

BORDER_PX = 1.5
"""A candidate with a corner nearer to the image's border than this, px, is cut. Chosen: outlines are found to
about a pixel."""

MIRRORED_MALUS = 0.02
"""By how much more alike a mirror image must be than a marker. Chosen: more than rounding, and less than a
wrong cell of the smallest codes, 0.05."""

DARK_LEVELS = 25.0
"""A dark quadrilateral without bits is reported if its surroundings are brighter by this, grey levels.
Chosen: fainter ones are shadows and texture."""

TINY_PX = 10.0
"""Side, px, below which a quadrilateral is compared with markers also at the edges that its sides have.
Chosen: a pixel by which it is off is more than half a cell."""

RIVALS = ("another marker", "bits by chance", "a light rectangle", "another grid")
"""What a candidate may be instead of a marker, in the order of `MarkerOdds.against`."""


@dataclass(frozen=True)
class Rejection:
    """A candidate that is no detection, and why.

    Attributes:
        reason: what is wrong with it.
        measured: the quantity that fails, with its limit; None if the reason is no quantity.
        corners_px: (4, 2) corners, px, in order around it; they may lie outside the image.
        reading: what it shows of the marker that it resembles; None of a quadrilateral without bits.
        words: the reason with its numbers, and what to do about it.
        log_odds: natural logarithm of the odds that it is a marker, at its edges; -inf if that is hopeless
            or it has no bits.
        rival: what else it is most likely to be; empty if it has no bits.
    """

    reason: Reason
    measured: Measured | None
    corners_px: Array
    reading: Reading | None
    words: str
    log_odds: float
    rival: str

    @property
    def center_px(self) -> Array:
        """Return mean (2,) of the corners, px."""
        return np.asarray(self.corners_px.mean(axis=0))

    @property
    def side_px(self) -> float:
        """Return side of a square of the same area, px."""
        return float(sides_of_corners(self.corners_px[None])[0])


def detect_and_explain(
    image: Image, dictionary: str, *, repeats: bool = False, time_s: float = 0.0
) -> tuple[Detections, list[Rejection]]:
    """Return what the default detector finds in a grey image, and what `explain` says of the rest.

    The image is searched once for both.

    Args:
        image: grey, (height, width), uint8.
        dictionary: name of the dictionary.
        repeats: whether an id is reported at every place where it is found.
        time_s: time of the image, s.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    image, detector = check_grey(image), PhotometricDetector(dictionary, following=False, repeats=repeats)
    searches = detector.searches(image)
    found = detector.detections_of(image, searches, time_s=time_s)
    return found, _explained(image, detector, searches, found)


def explain(image: Image, dictionary: str, detections: Detections | None = None) -> list[Rejection]:
    """Return why each thing that looks like a marker in a grey image was not detected.

    Candidates that coincide with a detection, lie inside one, or are part of a better candidate are left
    out. The most marker-like comes first, dark quadrilaterals without bits last.

    Args:
        image: grey, (height, width), uint8.
        dictionary: name of the dictionary.
        detections: what was detected; by the default detector if left out.

    Raises:
        InputError: the image is not a grey one of 8 bits, or there is no such dictionary.
    """
    image, detector = check_grey(image), PhotometricDetector(dictionary, following=False)
    searches = detector.searches(image)
    found = detector.detections_of(image, searches) if detections is None else detections
    return _explained(image, detector, searches, found)


def _explained(
    image: Image,
    detector: PhotometricDetector,
    searches: tuple[SearchPass, SearchPass],
    detections: Detections,
) -> list[Rejection]:
    """Return why each thing that looks like a marker was not detected, by both searches of the image."""
    dictionary, quads_px = detector.dictionary, np.concatenate([look.quads_px for look in searches])
    quads_px = quads_px[~on_detections(quads_px, detections, dictionary)]
    suspects = _suspects(image, dictionary, searches, quads_px, detections)
    suspects = suspects.take(np.argsort(-suspects.ranks, kind="stable"))
    suspects = suspects.take(first_of_each_place(suspects.corners_px))
    likely = _likely(image, dictionary, searches, suspects, detections)
    return likely + _plain(image, dictionary, quads_px, likely)


def _likely(
    image: Image,
    dictionary: str,
    searches: tuple[SearchPass, SearchPass],
    suspects: "_Suspects",
    detections: Detections,
) -> list[Rejection]:
    """Return the suspects that have bits, with the reason and the evidence at the poses by their edges."""
    fitted_px, failures = _fitted(image, dictionary, searches, suspects)
    readings = read_markers(image, suspects.named, fitted_px, dictionary)
    clockwise_px = np.array([one.corners_px[:: -1 if one.mirrored else 1] for one in readings]).reshape(
        -1, 4, 2
    )
    edges = fit_edges(image, clockwise_px, cells_per_side(dictionary))
    odds, least = marker_odds(image, edges.corners_px, dictionary), min_log_odds(dictionary)
    there = Counter(detections.ids.tolist())
    exact = [good or _is_exact(reading) for good, reading in zip(suspects.good, readings, strict=True)]
    there.update(reading.nearest_id for reading, counts in zip(readings, exact, strict=True) if counts)
    are_parts = _are_parts(image, dictionary, searches, fitted_px)
    likely = []
    for row, reading in enumerate(readings):
        log_odds, fitted = float(odds.log_odds[row]), bool(suspects.fits[row] >= 0)
        seen, good = bool(suspects.seen[row]), bool(suspects.good[row])
        suspect = Suspect(reading, seen, fitted, good, failures[row], log_odds, bool(are_parts[row]))
        reason, measured = find_reason(suspect, again=there[reading.nearest_id] > 1)
        if reason is not Reason.NO_BITS:
            rival = RIVALS[int(np.argmin(np.nan_to_num(odds.against[row], nan=np.inf)))]
            words = describe(reason, measured, reading, dictionary)
            if np.isfinite(log_odds):
                words += f"; log odds of a marker {log_odds:.1f} against {rival}, at least {least:.1f}"
            likely.append(Rejection(reason, measured, reading.corners_px, reading, words, log_odds, rival))
    return likely


def _plain(image: Image, dictionary: str, quads_px: Array, likely: list[Rejection]) -> list[Rejection]:
    """Return the dark quadrilaterals (N, 4, 2) that share no place with what has bits, one of each place."""
    dark_px = quads_px[~_are_cut(image, quads_px)]
    dark_px = dark_px[depths(image, dark_px, dictionary) >= DARK_LEVELS]
    likely_px = np.array([one.corners_px for one in likely]).reshape(-1, 4, 2)
    apart = first_of_each_place(np.concatenate([likely_px, dark_px])) - len(likely)
    return [
        Rejection(Reason.NO_BITS, None, corners_px, None, WORDS[Reason.NO_BITS], -np.inf, "")
        for corners_px in dark_px[apart[apart >= 0]]
    ]


def _suspects(
    image: Image,
    dictionary: str,
    searches: tuple[SearchPass, SearchPass],
    quads_px: Array,
    detections: Detections,
) -> "_Suspects":
    """Return all places that may show a marker and are no detections.

    They are the candidates of both searches, quadrilaterals (N, 4, 2) that resemble markers, tiny ones also
    at their edges, and guesses.
    """
    both = searches[0].joined(searches[1])
    count = both.good.size
    named = Named(both.candidates, np.zeros(count, dtype=bool))
    tried = _Suspects(named, np.ones(count, dtype=bool), np.arange(count), both.good)
    tiny = (sides_of_corners(quads_px) < TINY_PX) & (depths(image, quads_px, dictionary) >= DARK_LEVELS)
    edges_px = fit_edges(image, quads_px[tiny], cells_per_side(dictionary)).corners_px
    outlines_px = np.concatenate([quads_px, edges_px])
    seen = tried.joined(_Suspects.of(name_quads(image, outlines_px, dictionary)))
    seen = seen.joined(_Suspects.of(name_quads(image, dark_patches(image), dictionary), seen=False))
    is_whole = ~_are_cut(image, seen.corners_px) | (seen.named.decoded.correlations >= CERTAIN)
    guesses = _Suspects.of(guess_markers(image, dictionary, detections), seen=False)
    suspects = seen.take(seen.good | is_whole).joined(guesses)
    return suspects.take(~on_detections(suspects.corners_px, detections, dictionary))


@dataclass(frozen=True)
class _Suspects(RowRecord):
    """N possible markers, and the stages that the detector reached with them.

    Attributes:
        named: of each the marker that it resembles most.
        seen: (N,) whether the search found an outline.
        fits: (N,) number of its fit in both searches; -1 if it was not fitted there.
        good: (N,) whether it is accepted.
    """

    named: Named
    seen: BoolArray
    fits: IntArray
    good: BoolArray

    @classmethod
    def of(cls, named: Named, *, seen: bool = True) -> "_Suspects":
        """Return suspects that were not fitted."""
        count = named.mirrored.size
        return cls(named, np.full(count, seen), np.full(count, -1), np.zeros(count, dtype=bool))

    @property
    def corners_px(self) -> Array:
        """Return the corners (N, 4, 2), px."""
        return self.named.decoded.corners_px

    @property
    def ranks(self) -> Array:
        """Return ranks (N,), of which the highest of a place stays."""
        likeness = self.named.decoded.correlations - MIRRORED_MALUS * self.named.mirrored
        return np.asarray(likeness + 2.0 * self.good)


def _fitted(
    image: Image, dictionary: str, searches: tuple[SearchPass, SearchPass], suspects: _Suspects
) -> tuple[Array, list[tuple[Quantity, Measured] | None]]:
    """Return the corners (N, 4, 2) of suspects by fits, px, and the test that each fails, or None.

    Suspects without a fit of the searches are fitted here, apart from mirror images.
    """
    (first, second), decoded, numbers = searches, suspects.named.decoded, suspects.fits.copy()
    noise, distance = image_noise(image), code_distance(dictionary)
    rest = np.flatnonzero((numbers < 0) & ~suspects.named.mirrored)
    numbers[rest] = first.good.size + second.good.size + np.arange(rest.size)
    start = LocalHomographies.of_corners(decoded.corners_px[rest])
    more = (
        fit_alone(image, dictionary, decoded.ids[rest], start, noise)
        if rest.size
        else no_fit_results(dictionary)
    )
    failures: list[tuple[Quantity, Measured] | None] = []
    known = no_fit_results(dictionary)
    for fits, good in (
        (first.fits, first.good),
        (second.fits, second.good),
        (more, np.zeros(rest.size, dtype=bool)),
    ):
        both = known.joined(fits)
        tests = verification_tests(both, noise, distance) if both.ids.size else []
        failures += [failed_test(tests, known.ids.size + row) for row in range(good.size)]
        known = known.joined(fits.take(good))
    rows, corners_px = np.flatnonzero(numbers >= 0), decoded.corners_px.copy()
    shapes = first.fits.joined(second.fits).joined(more).homographies.take(numbers[rows])
    corners_px[rows] = to_points(shapes.images(SQUARE_CORNERS))
    return corners_px, [None if number < 0 else failures[number] for number in numbers.tolist()]


def _are_parts(
    image: Image, dictionary: str, searches: tuple[SearchPass, SearchPass], fitted_px: Array
) -> BoolArray:
    """Return which markers at corners (N, 4, 2), px, count as a part of one that the border cuts."""
    if code_distance(dictionary) >= STRONG_DISTANCE:
        return np.zeros(len(fitted_px), dtype=bool)
    shapes = LocalHomographies.of_corners(fitted_px)
    return may_be_cut(shapes, searches[1].plane, image.shape[::-1])


def _are_cut(image: Image, quads_px: Array) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) reach the border of an image: it may be their outline."""
    last_px = np.array(image.shape[::-1]) - 1
    return np.asarray(((quads_px < BORDER_PX) | (quads_px > last_px - BORDER_PX)).any(axis=(1, 2)))


def _is_exact(reading: Reading) -> bool:
    """Return whether it is plainly a marker, with no wrong bit, and no mirror image of one."""
    return reading.wrong_bits == 0 and reading.likeness >= CERTAIN and not reading.mirrored
