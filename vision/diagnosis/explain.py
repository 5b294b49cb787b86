"""Why markers were not detected: where the default detector loses each candidate, and by which limit.

The stages are those of the detector, and the results of its searches are taken as they are
(`PhotometricDetector.searches`). A candidate that was fitted is explained by the first test that its fit
fails, and by its log odds. An outline that was not decoded is explained by its wrong cells. Other markers are
searched for in slower ways (`candidates`), read by correlation with all markers (`quad_reading`), and fitted
to find the test that they would fail.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import card_side, cells_per_side, code_distance
from skyherd.messages import Detections
from skyherd.vision.detectors.registry import create_detector
from skyherd.vision.diagnosis.candidates import bright_groups, cut_squares, dark_patches, dark_quads
from skyherd.vision.diagnosis.quad_reading import PROMISING, Reading, read_likely, read_quad
from skyherd.vision.diagnosis.reasons import (
    CERTAIN,
    Measured,
    Reason,
    Suspect,
    failed_test,
    find_reason,
    is_clear,
    is_cut,
    is_dark,
)
from skyherd.vision.diagnosis.wording import describe
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.likelihood import MarkerOdds, marker_odds, min_log_odds
from skyherd.vision.photometric.verify import Quantity, verification_tests
from skyherd.vision.search.decode import decode_quads
from skyherd.vision.search.edges import fit_edges

GROWTHS_PX = (0.5, 1.0)
"""By how much a contour is moved outwards and read again, px. Derived: thresholds lose up to a pixel of an
edge."""

REACH = 0.6
"""A candidate centred within this share of a detected card's side from its centre is part of that card.
Chosen: more than half, for candidates that reach over its edge."""

BONUS = 0.3
"""Added to the rank of candidates that read without a fault or have a clear frame, and of those that were
fitted, a likeness. Chosen: more than likenesses of markers in one place differ by."""

VISIBLE_EXPONENT = 0.25
"""Exponent of the share in the image in a candidate's rank. Chosen: a square half outside loses a sixth."""

RIVALS = ("another marker", "bits by chance", "a light rectangle", "another grid")
"""What a candidate may be instead of a marker, in the order of `MarkerOdds.against`."""

GUESS, SURE, MIN_VISIBLE = 0.75, 0.93, 0.4
"""Likeness at first and second look, and share in the image, that make a guessed square a marker. Chosen
high, since many squares are guessed and chance is like some marker too."""


@dataclass(frozen=True)
class Rejection:
    """A candidate that is no detection, and why.

    Attributes:
        reason: what is wrong with it.
        measured: the quantity that fails, with its limit; None if the reason is no quantity.
        reading: what its cells read.
        words: the reason with its numbers, and what to do about it.
        log_odds: natural logarithm of the odds that it is a marker, at its edges; -inf if that is hopeless.
        rival: what else it is most likely to be.
    """

    reason: Reason
    measured: Measured | None
    reading: Reading
    words: str
    log_odds: float
    rival: str

    @property
    def corners_px(self) -> Array:
        """Return corners (4, 2), px, in order around the candidate; they may lie outside the image."""
        return self.reading.corners_px

    @property
    def center_px(self) -> Array:
        """Return mean (2,) of the corners, px."""
        return np.asarray(self.corners_px.mean(axis=0))


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
    image, detector = check_grey(image), PhotometricDetector(dictionary, following=False, repeats=True)
    if detections is None:
        detections = create_detector(dictionary=dictionary).detect(image)
    suspects: list[Suspect] = []
    for suspect in sorted(_all_suspects(image, detector, detections), key=_rank, reverse=True):
        if not _is_part(suspect.reading, suspects):
            suspects.append(suspect)
    there = Counter(detections.ids.tolist())
    there.update(s.reading.nearest_id for s in suspects if s.good or _is_exact(s.reading))
    rejections = []
    odds = _odds(image, [suspect.reading.corners_px for suspect in suspects], dictionary)
    for suspect, log_odds, against in zip(suspects, odds.log_odds.tolist(), odds.against, strict=True):
        reading = suspect.reading
        if not suspect.seen:
            suspect = replace(suspect, failed=_failed_all_the_same(image, detector, reading))
        again = there[reading.nearest_id] > 1
        reason, measured = find_reason(suspect, again=again)
        if reason is Reason.NO_BITS and not is_dark(reading):
            continue
        rival = RIVALS[int(np.argmin(np.nan_to_num(against, nan=np.inf)))]
        words = describe(reason, measured, reading, dictionary)
        if np.isfinite(log_odds):
            least = min_log_odds(dictionary)
            words += f"; log odds of a marker {log_odds:.1f} against {rival}, at least {least:.1f}"
        rejections.append(Rejection(reason, measured, reading, words, log_odds, rival))
    return sorted(rejections, key=lambda rejection: rejection.reason is Reason.NO_BITS)


def _odds(image: Image, corners_px: list[Array], dictionary: str) -> MarkerOdds:
    """Return the evidence that candidates are markers, at the poses by their edges."""
    corners = np.array(corners_px).reshape(-1, 4, 2)
    edges = fit_edges(image, corners, cells_per_side(dictionary))
    return marker_odds(image, edges.corners_px, dictionary)


def _all_suspects(image: Image, detector: PhotometricDetector, detections: Detections) -> list[Suspect]:
    """Return all that may be markers, apart from the detections.

    Candidates that reach the image's border and read with a fault are left out: it may be their outline.
    """
    dictionary = detector.dictionary
    first, second = detector.searches(image)
    reach_px = REACH * card_side(dictionary) * detections.sides_px

    def is_known(corners_px: Array) -> bool:
        return _is_known(corners_px, detections.centers_px, reach_px)

    noise, distance = image_noise(image), code_distance(dictionary)
    suspects: list[Suspect] = []
    for look, beside in ((first, None), (second, first.found)):
        fits = look.fits if beside is None else beside.joined(look.fits)
        tests = verification_tests(fits, noise, distance) if fits.ids.size else []
        for row, corners_px in enumerate(look.candidates.corners_px):
            if not is_known(corners_px):
                failed = failed_test(tests, fits.ids.size - look.fits.ids.size + row)
                reading = _read_grown(image, corners_px, dictionary)
                good = bool(look.good[row])
                suspects.append(Suspect(reading, True, True, good, None if good else failed))
        unread = [quad for quad in look.quads_px if not is_known(quad)]
        suspects += [Suspect(_read_grown(image, quad, dictionary), seen=True) for quad in unread]
    size_px = np.array([image.shape[1], image.shape[0]])
    suspects = [s for s in suspects if s.good or _is_exact(s.reading) or not is_cut(s.reading, size_px)]
    unseen = _read_unseen(image, dictionary, is_known)
    return suspects + [Suspect(reading, seen=False) for reading in unseen]


def _read_unseen(image: Image, dictionary: str, is_known: Callable[[Array], bool]) -> list[Reading]:
    """Return readings of what the search may not have found.

    Guessed squares count only if they read without a fault. So do squares that touch the border, whose
    outline may be the border itself.
    """
    size_px = np.array([image.shape[1], image.shape[0]])
    outlines = [*dark_quads(image, dictionary), *dark_patches(image)]
    guesses = [*cut_squares(image, dictionary), *bright_groups(image, dictionary)]
    seen = [_read_grown(image, quad, dictionary) for quad in outlines if not is_known(quad)]
    whole = [reading for reading in seen if not is_cut(reading, size_px)]
    doubtful = [reading for reading in seen if is_cut(reading, size_px)]
    likely = (read_likely(image, quad, dictionary, GUESS) for quad in guesses if not is_known(quad))
    doubtful += [reading for reading in likely if reading is not None]
    return whole + [
        r for r in doubtful if r.likeness >= SURE and r.wrong_bits == 0 and r.visible >= MIN_VISIBLE
    ]


def _failed_all_the_same(
    image: Image, detector: PhotometricDetector, reading: Reading
) -> tuple[Quantity, Measured] | None:
    """Return the test that a fit from a reading's corners fails, or None."""
    if not _is_exact(reading):
        return None
    sigma_px = reading.blur_cells * float(reading.cell_px.mean())
    candidates = decode_quads(image, reading.corners_px[None], detector.dictionary, sigma_px)
    fits = detector.measure(image, candidates).fits
    if not fits.ids.size:
        return None
    return failed_test(verification_tests(fits, image_noise(image), code_distance(detector.dictionary)), 0)


def _read_grown(image: Image, corners_px: Array, dictionary: str) -> Reading:
    """Return the most marker-like reading of a contour moved outwards; thresholds lose up to a pixel."""
    center = corners_px.mean(axis=0)
    reach = float(np.linalg.norm(corners_px - center, axis=1).mean()) / np.sqrt(2)
    readings = [read_quad(image, corners_px, dictionary)]
    if readings[0].likeness > PROMISING:
        readings += [
            read_quad(image, _grown(corners_px, 1 + grow / reach), dictionary) for grow in GROWTHS_PX
        ]
    return max(readings, key=_likeness)


def _is_exact(reading: Reading) -> bool:
    """Return whether it is plainly a marker, with no wrong bit, and no mirror image of one."""
    return reading.wrong_bits == 0 and reading.likeness >= CERTAIN and not reading.mirrored


def _rank(suspect: Suspect) -> tuple[float, bool]:
    """Return the rank of a suspect: its likeness, and whether it was fitted. The highest of a place stays."""
    reached = (suspect.fitted and suspect.reading.wrong_bits == 0) + 2 * suspect.good
    return _likeness(suspect.reading) + BONUS * reached, suspect.fitted


def _likeness(reading: Reading) -> float:
    """Return how marker-like a reading is."""
    return float(reading.likeness * reading.visible**VISIBLE_EXPONENT + BONUS * _reads_well(reading))


def _reads_well(reading: Reading) -> bool:
    """Return whether it reads without a fault, mirrored or not, or has a clear frame."""
    exact = reading.likeness >= CERTAIN and reading.wrong_bits == 0
    return exact or (is_clear(reading) and is_dark(reading))


def _contains(corners_px: Array, point_px: Array) -> bool:
    return (
        cv2.pointPolygonTest(corners_px.astype(np.float32), (float(point_px[0]), float(point_px[1])), False)
        > 0
    )


def _grown(corners_px: Array, factor: float) -> Array:
    center = corners_px.mean(axis=0)
    return np.asarray(center + factor * (corners_px - center))


def _is_known(corners_px: Array, centers_px: Array, reach_px: Array) -> bool:
    """Return whether a quadrilateral is, lies on, or surrounds one of the detections at centres (N, 2)."""
    center = corners_px.mean(axis=0)
    distances = np.linalg.norm(centers_px - center, axis=1)
    if (distances < reach_px).any():
        return True
    extent = np.linalg.norm(corners_px - center, axis=1).max()
    return any(_contains(corners_px, centers_px[k]) for k in np.flatnonzero(distances < extent))


def _is_part(reading: Reading, better: list[Suspect]) -> bool:
    """Return whether it shares its place with a better candidate."""
    center = reading.corners_px.mean(axis=0)
    return any(
        _contains(other.reading.corners_px, center)
        or _contains(reading.corners_px, other.reading.corners_px.mean(axis=0))
        for other in better
    )
