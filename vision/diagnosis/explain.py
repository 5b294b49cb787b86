"""Why markers were not detected: where the default detector loses each candidate, and by which limit.

The stages are those of the detector, and the results of its searches are taken as they are
(`PhotometricDetector.searches`). A candidate that was fitted is explained by the first test that its fit
fails, and by its log odds. An outline that was not decoded is explained by its wrong cells. Other markers are
searched for in slower ways (`candidates`), read by correlation with all markers (`quad_reading`), and fitted
to find the test that they would fail.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import card_side, cells_per_side, code_distance
from skyherd.messages import Detections
from skyherd.vision.diagnosis.candidates import bright_groups, cut_squares, dark_patches, dark_shapes
from skyherd.vision.diagnosis.places import first_of_each_place, lie_on_markers
from skyherd.vision.diagnosis.quad_reading import Reading, read_outlines, read_quads, show_all_bits
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
from skyherd.vision.photometric.candidates import SearchPass
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.likelihood import marker_odds, min_log_odds
from skyherd.vision.photometric.verify import Quantity, verification_tests
from skyherd.vision.search.decode import decode_quads
from skyherd.vision.search.edges import fit_edges

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

SURE, MIN_VISIBLE = 0.93, 0.4
"""Likeness and share in the image that make a guessed square a marker, if all of its bits are right. Chosen
high, since many squares are guessed and chance is like some marker too."""


@dataclass(frozen=True)
class Rejection:
    """A candidate that is no detection, and why.

    Attributes:
        reason: what is wrong with it.
        measured: the quantity that fails, with its limit; None if the reason is no quantity.
        reading: what its cells read.
        words: the reason with its numbers, and what to do about it.
        log_odds: natural logarithm of the odds that it is a marker, at its edges; -inf if that is hopeless
            or it has no bits.
        rival: what else it is most likely to be; empty if it has no bits.
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
    dictionary = detector.dictionary
    suspects = sorted(_all_suspects(image, dictionary, searches, detections), key=_rank, reverse=True)
    suspects = [suspects[row] for row in first_of_each_place(_corners_px(suspects))]
    there = Counter(detections.ids.tolist())
    there.update(s.reading.nearest_id for s in suspects if s.good or _is_exact(s.reading))
    likely, plain = list[tuple[Suspect, Reason, Measured | None]](), list[Rejection]()
    for suspect in suspects:
        if not suspect.seen:
            suspect = replace(suspect, failed=_failed_all_the_same(image, detector, suspect.reading))
        reason, measured = find_reason(suspect, again=there[suspect.reading.nearest_id] > 1)
        if reason is not Reason.NO_BITS:
            likely.append((suspect, reason, measured))
        elif is_dark(suspect.reading):
            words = describe(reason, measured, suspect.reading, dictionary)
            plain.append(Rejection(reason, measured, suspect.reading, words, -np.inf, ""))
    return _with_odds(image, dictionary, likely) + plain


def _with_odds(
    image: Image, dictionary: str, likely: list[tuple[Suspect, Reason, Measured | None]]
) -> list[Rejection]:
    """Return the rejections of what resembles markers, with the evidence at the poses by their edges."""
    edges = fit_edges(image, _corners_px([suspect for suspect, _, _ in likely]), cells_per_side(dictionary))
    odds = marker_odds(image, edges.corners_px, dictionary)
    rejections, least = [], min_log_odds(dictionary)
    for row, (suspect, reason, measured) in enumerate(likely):
        log_odds = float(odds.log_odds[row])
        rival = RIVALS[int(np.argmin(np.nan_to_num(odds.against[row], nan=np.inf)))]
        words = describe(reason, measured, suspect.reading, dictionary)
        if np.isfinite(log_odds):
            words += f"; log odds of a marker {log_odds:.1f} against {rival}, at least {least:.1f}"
        rejections.append(Rejection(reason, measured, suspect.reading, words, log_odds, rival))
    return rejections


def _corners_px(suspects: list[Suspect]) -> Array:
    """Return the corners (N, 4, 2) of suspects, px."""
    return np.array([suspect.reading.corners_px for suspect in suspects]).reshape(-1, 4, 2)


def _all_suspects(
    image: Image, dictionary: str, searches: tuple[SearchPass, SearchPass], detections: Detections
) -> list[Suspect]:
    """Return all that may be markers, apart from the detections.

    Candidates that reach the image's border and read with a fault are left out: it may be their outline.
    """
    first, second = searches
    reaches_px = REACH * card_side(dictionary) * detections.sides_px

    def unknown(quads_px: Array) -> Array:
        return quads_px[~lie_on_markers(quads_px, detections.centers_px, reaches_px)]

    noise, distance = image_noise(image), code_distance(dictionary)
    suspects: list[Suspect] = []
    for look, beside in ((first, None), (second, first.found)):
        fits = look.fits if beside is None else beside.joined(look.fits)
        tests = verification_tests(fits, noise, distance) if fits.ids.size else []
        known = lie_on_markers(look.candidates.corners_px, detections.centers_px, reaches_px)
        rows = np.flatnonzero(~known)
        readings = read_outlines(image, look.candidates.corners_px[rows], dictionary)
        for row, reading in zip(rows.tolist(), readings, strict=True):
            failed = failed_test(tests, fits.ids.size - look.fits.ids.size + row)
            good = bool(look.good[row])
            suspects.append(Suspect(reading, True, True, good, None if good else failed))
        others = read_outlines(image, unknown(look.quads_px), dictionary)
        suspects += [Suspect(reading, seen=True) for reading in others]
    size_px = np.array([image.shape[1], image.shape[0]])
    suspects = [s for s in suspects if s.good or _is_exact(s.reading) or not is_cut(s.reading, size_px)]
    shapes = dark_shapes(image)
    patches = read_outlines(image, unknown(dark_patches(shapes)), dictionary)
    guesses = np.concatenate([cut_squares(shapes, size_px, dictionary), bright_groups(image, dictionary)])
    unseen = _whole_or_sure(image, patches) + _sure_guesses(image, unknown(guesses), dictionary)
    return suspects + [Suspect(reading, seen=False) for reading in unseen]


def _whole_or_sure(image: Image, readings: list[Reading]) -> list[Reading]:
    """Return readings without those that reach the image's border, which may be their outline.

    Such a reading counts if it reads without a fault.
    """
    size_px = np.array([image.shape[1], image.shape[0]])
    return [reading for reading in readings if not is_cut(reading, size_px) or _is_sure(reading)]


def _sure_guesses(image: Image, quads_px: Array, dictionary: str) -> list[Reading]:
    """Return readings of the guessed squares (N, 4, 2) that read without a fault."""
    shown = show_all_bits(image, quads_px, dictionary, MIN_VISIBLE)
    return [reading for reading in read_quads(image, quads_px[shown], dictionary) if _is_sure(reading)]


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


def _is_exact(reading: Reading) -> bool:
    """Return whether it is plainly a marker, with no wrong bit, and no mirror image of one."""
    return reading.wrong_bits == 0 and reading.likeness >= CERTAIN and not reading.mirrored


def _is_sure(reading: Reading) -> bool:
    """Return whether a square without an outline of its own is a marker, as far as its cells show."""
    return reading.likeness >= SURE and reading.wrong_bits == 0 and reading.visible >= MIN_VISIBLE


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
