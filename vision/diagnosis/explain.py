"""Why markers were not detected: the results of the detector's searches, one for each place, in words.

`PhotometricDetector.searches` returns all quadrilaterals, those that resemble a marker, their fits, and the
evidence for and against them. Of each place without a detection the best candidate is explained by the stage
that refuses it. Candidates that the searches do not fit pass through the same measurement here: those that
are not clear, dark regions without an outline, and markers that the image's border cuts. Mirror images are
confirmed by their log odds.
"""

from dataclasses import dataclass, replace

import numpy as np

from skyherd.geometry import Array, BoolArray, IntArray, to_complex
from skyherd.markers.dictionary import card_side, cells_per_side, code_distance, sides_of_corners
from skyherd.messages import Detections
from skyherd.vision.diagnosis.reading import (
    FINE_SAMPLES,
    Cells,
    Reading,
    is_border,
    likeness_and_blurs,
    read_cut_squares,
)
from skyherd.vision.diagnosis.reasons import (
    CERTAIN,
    WORDS,
    Measured,
    Reason,
    Stage,
    describe,
    failed_test,
    find_reason,
)
from skyherd.vision.grey import Image, check_grey
from skyherd.vision.photometric.candidates import SearchPass, Weighed
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.evidence.likelihood import MarkerOdds, marker_odds, min_log_odds, no_odds
from skyherd.vision.photometric.fitting.fit_result import FitResults
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.image_noise import image_noise
from skyherd.vision.photometric.measure import fit_alone
from skyherd.vision.photometric.refine import START_SIGMA_PX
from skyherd.vision.photometric.verify import verification_tests
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.dark import cut_squares, dark_outlines, square_patches
from skyherd.vision.search.decode import MIN_CORRELATION, DecodedQuads, decode_quads
from skyherd.vision.search.edges import fit_edges

REACH = 0.6
"""A candidate centred within this share of a detected card's side from its centre is part of that card.
Chosen: more than half, for candidates that reach over its edge."""

BORDER_PX = 1.5
"""A candidate with a corner nearer to the image's border than this, px, is cut, unless it is a marker.
Chosen: outlines are found to about a pixel."""

MIRRORED_CORRELATION, MALUS = 0.9, 0.02
"""Smallest correlation of a mirror image, and by how much that of one, or of a region without an outline,
must exceed that of a quadrilateral. Chosen: two wrong cells of 36; more than rounding, and less than a wrong
cell of the smallest codes, 0.05."""

DARK_LEVELS = 25.0
"""A dark quadrilateral without bits is reported if its surroundings are brighter by this, grey levels.
Chosen: fainter ones are shadows and texture."""

MAX_MOVED_SIDES, MAX_FRAME_ERRORS = 0.25, 0.25
"""Largest move of a centre by a fit, in sides, and largest share of a frame's cells that are not black.
Chosen: beyond it the fit has found something else; one side of four may be lost."""

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
        log_odds: natural logarithm of the odds that it is a marker; -inf if that is hopeless or it has no
            bits.
        against: (4,) log odds against each of `RIVALS` alone; -inf or inf where it was not compared.
    """

    reason: Reason
    measured: Measured | None
    corners_px: Array
    reading: Reading | None
    words: str
    log_odds: float
    against: Array

    @property
    def center_px(self) -> Array:
        """Mean (2,) of the corners, px."""
        return np.asarray(self.corners_px.mean(axis=0))

    @property
    def side_px(self) -> float:
        """Side of a square of the same area, px."""
        return float(sides_of_corners(self.corners_px[None])[0])

    @property
    def rival(self) -> str:
        """The likeliest of `RIVALS`; empty if the log odds are hopeless."""
        return RIVALS[int(np.argmin(self.against))] if np.isfinite(self.log_odds) else ""


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
    return found, _explained(image, dictionary, searches, found)


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
    return _explained(image, dictionary, searches, found)


def _explained(
    image: Image, dictionary: str, searches: tuple[SearchPass, SearchPass], detections: Detections
) -> list[Rejection]:
    """Return why each thing that looks like a marker was not detected, by both searches of the image."""
    searched, middles_px = searches[0].joined(searches[1]), detections.centers_px[:, None]
    cards_px = middles_px + 2 * REACH * card_side(dictionary) * (detections.corners_px - middles_px)
    quads_px = searched.quads_px[_apart(searched.quads_px, cards_px)]
    quads = Cells.read(image, quads_px, dictionary)
    quads_px = quads_px[quads.surroundings - quads.blacks >= DARK_LEVELS]
    suspects = _suspects(image, dictionary, searched, quads_px)
    suspects = suspects.take(_apart(suspects.decoded.corners_px, cards_px))
    suspects = suspects.take(_best_of_places(suspects.decoded.corners_px, suspects.merits))
    likely = _likely(image, dictionary, searched, suspects)
    likely_px = np.array([one.corners_px for one in likely]).reshape(-1, 4, 2)
    plain_px = quads_px[_apart(quads_px, likely_px) & ~_are_cut(image, quads_px)]
    plain_px = plain_px[_best_of_places(plain_px, np.zeros(len(plain_px)))]
    words, never = WORDS[Reason.NO_BITS], np.full(len(RIVALS), -np.inf)
    return likely + [
        Rejection(Reason.NO_BITS, None, corners_px, None, words, -np.inf, never) for corners_px in plain_px
    ]


@dataclass(frozen=True)
class _Suspects(RowRecord):
    """N possible markers.

    Attributes:
        decoded: of each the marker that it resembles most.
        stages: (N,) values of `Stage`.
        rows: (N,) numbers among the candidates of the searches; -1 if it was not fitted there.
    """

    decoded: DecodedQuads
    stages: IntArray
    rows: IntArray

    @classmethod
    def of(cls, decoded: DecodedQuads, stage: Stage) -> "_Suspects":
        """Return suspects that were not fitted."""
        return cls(decoded, np.full(decoded.ids.size, stage), np.full(decoded.ids.size, -1))

    @property
    def merits(self) -> Array:
        """Merits (N,), of which the highest of a place stays."""
        malus = MALUS * ((self.stages == Stage.MIRRORED) | (self.stages == Stage.UNSEEN))
        return np.asarray(self.decoded.correlations - malus + 2.0 * (self.stages <= Stage.PART))


def _suspects(image: Image, dictionary: str, searched: SearchPass, quads_px: Array) -> _Suspects:
    """Return all places that may show a marker; `quads_px` (Q, 4, 2) are the dark ones beside detections."""
    n, outlines_px = cells_per_side(dictionary), dark_outlines(image)
    stages = np.select([searched.good, searched.parts], [Stage.ACCEPTED, Stage.PART], Stage.FITTED)
    seen = _Suspects(searched.candidates, stages, np.arange(stages.size))
    alike = searched.decoded.take(searched.decoded.correlations >= MIN_CORRELATION)
    patches = decode_quads(image, square_patches(outlines_px), dictionary, START_SIGMA_PX)
    seen = seen.joined(_Suspects.of(alike, Stage.DECODED)).joined(_Suspects.of(patches, Stage.UNSEEN))
    is_whole = ~_are_cut(image, seen.decoded.corners_px)
    seen = seen.take(is_whole | (seen.stages == Stage.ACCEPTED) | (seen.decoded.correlations >= CERTAIN))
    cut = read_cut_squares(image, cut_squares(outlines_px, image, n), dictionary)
    turned_px = np.ascontiguousarray(quads_px[:, ::-1])
    mirrored = decode_quads(image, turned_px, dictionary, START_SIGMA_PX, MIRRORED_CORRELATION)
    return seen.joined(_Suspects.of(cut, Stage.CUT)).joined(_Suspects.of(mirrored, Stage.MIRRORED))


def _likely(image: Image, dictionary: str, searched: SearchPass, suspects: _Suspects) -> list[Rejection]:
    """Return the suspects that have bits, with the reason and the evidence.

    Those that the searches did not fit are fitted and weighed here; mirror images are only weighed.
    """
    rows, mirrored = suspects.rows.copy(), suspects.stages == Stage.MIRRORED
    rest, turned = np.flatnonzero((rows < 0) & ~mirrored), np.flatnonzero(mirrored)
    both, noise, fits = np.concatenate([rest, turned]), image_noise(image), searched.fits
    rows[both] = fits.ids.size + np.arange(both.size)
    weighed = searched.weighed.joined(_weighed(image, dictionary, suspects.take(both), rows[both]))
    if rest.size:
        others = suspects.decoded.take(rest)
        start = LocalHomographies.of_corners(others.corners_px)
        fits = fits.joined(fit_alone(image, dictionary, others.ids, start, noise))
    readings, odds = _read(image, dictionary, fits, weighed, suspects, rows)
    tests = verification_tests(fits, noise, code_distance(dictionary)) if fits.ids.size else []
    there, least, likely = searched.found.ids, float(min_log_odds(dictionary)), list[Rejection]()
    for reading, row, stage, log_odds, against in zip(
        readings, rows, suspects.stages, odds.log_odds, odds.against, strict=True
    ):
        failed = failed_test(tests, row) if row < fits.ids.size else None
        again = bool(np.count_nonzero(there == reading.nearest_id) > 1)
        reason, value = find_reason(reading, Stage(stage), failed, log_odds, again=again)
        if reason is Reason.NO_BITS or (reason is Reason.MIRRORED and log_odds < least):
            continue
        words = describe(reason, value, reading, dictionary)
        one = Rejection(reason, value, reading.corners_px, reading, words, float(log_odds), against)
        evidence = f"; log odds of a marker {log_odds:.1f} against {one.rival}"
        evidence += f", at least {least:.1f} without further evidence"
        likely.append(replace(one, words=words + evidence) if one.rival else one)
    return likely


def _weighed(image: Image, dictionary: str, suspects: _Suspects, rows: IntArray) -> Weighed:
    """Return the evidence for suspects (N,) with numbers (N,), at their edges."""
    mirrored, corners_px = (suspects.stages == Stage.MIRRORED)[:, None, None], suspects.decoded.corners_px
    clockwise_px = np.where(mirrored, corners_px[:, ::-1], corners_px)
    edges = fit_edges(image, clockwise_px, cells_per_side(dictionary))
    edges = replace(edges, corners_px=np.where(mirrored, edges.corners_px[:, ::-1], edges.corners_px))
    return Weighed(rows, edges, marker_odds(image, edges.corners_px, dictionary))


def _read(
    image: Image, dictionary: str, fits: FitResults, weighed: Weighed, suspects: _Suspects, rows: IntArray
) -> tuple[list[Reading], MarkerOdds]:
    """Return what N suspects show, and the evidence for them.

    They are read where they are most alike: at the outline, at the fit, if that is near, or at the edges.

    Args:
        image: grey, (height, width).
        dictionary: of the markers.
        fits: of all candidates except mirror images.
        weighed: evidence for those that are not verified.
        suspects: the N suspects.
        rows: (N,) their numbers among the candidates.
    """
    decoded, n = suspects.decoded, cells_per_side(dictionary)
    corners_px, ids, odds = decoded.corners_px.copy(), decoded.ids.copy(), no_odds(4 * decoded.ids)
    fitted = np.flatnonzero(rows < fits.ids.size)
    fits, numbers = fits.take(rows[fitted]), np.full(max([*rows, *weighed.rows], default=-1) + 1, -1)
    fitted_px = fits.corners_px
    moved_px = np.linalg.norm((fitted_px - corners_px[fitted]).mean(axis=1), axis=1)
    near = moved_px < MAX_MOVED_SIDES * sides_of_corners(corners_px[fitted])
    numbers[weighed.rows] = np.arange(weighed.rows.size)
    known = np.flatnonzero((numbers[rows] >= 0) & (suspects.stages != Stage.CUT))
    weighed = weighed.take(numbers[rows[known]])
    hopeful, odds = np.isfinite(weighed.odds.log_odds), odds.put(known, weighed.odds)
    edges_px = np.where(hopeful[:, None, None], weighed.corners_px, weighed.edges.corners_px)
    ids[known[hopeful]] = weighed.odds.ids[hopeful]
    likeness, blurs = likeness_and_blurs(image, corners_px, 4 * ids, dictionary)
    for few, others_px in ((fitted[near], fitted_px[near]), (known, edges_px)):
        alike, found = likeness_and_blurs(image, others_px, 4 * ids[few], dictionary)
        better = alike > likeness[few]
        changed = few[better]
        corners_px[changed], likeness[changed], blurs[changed] = (
            values[better] for values in (others_px, alike, found)
        )
    contrasts = odds.contrasts.copy()
    contrasts[fitted] = fits.contrasts
    cells, codes = Cells.read(image, corners_px, dictionary, FINE_SAMPLES), 4 * ids
    wrong, dark, visible = cells.wrong(codes, dictionary), cells.dark_edges(), cells.visible
    has_frame = wrong[:, is_border(dictionary)].mean(axis=1) <= MAX_FRAME_ERRORS
    maps = LocalHomographies.of_quads(corners_px)
    larger, smaller = np.abs(maps.similarities), np.abs(maps.anisotropies)
    extents_px = np.stack([np.abs(larger - smaller), larger + smaller], axis=1) / n
    numbered = [tuple((down + 1, along + 1) for down, along in np.argwhere(cells_of)) for cells_of in wrong]
    numbers_of = (contrasts, blurs, likeness, ids)
    values = corners_px, extents_px, *(v.tolist() for v in numbers_of), numbered, has_frame.tolist()
    return [Reading(*one) for one in zip(*values, dark.tolist(), visible.tolist(), strict=True)], odds


def _apart(quads_px: Array, taken_px: Array) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) share no place with one of others (M, 4, 2).

    Two share a place if the centre of the smaller one is within half a side of the larger one's.
    """
    centers, sides_px = to_complex(quads_px).mean(axis=1), sides_of_corners(quads_px)
    apart = np.ones(len(quads_px), dtype=bool)
    for center, side_px in zip(to_complex(taken_px).mean(axis=1), sides_of_corners(taken_px), strict=True):
        apart &= np.abs(centers - center) >= np.maximum(sides_px, side_px) / 2
    return apart


def _best_of_places(quads_px: Array, merits: Array) -> IntArray:
    """Return the rows of quadrilaterals (N, 4, 2) of the greatest merit in each place, the best first."""
    left, kept = np.argsort(-merits, kind="stable"), list[int]()
    centers, sides_px = to_complex(quads_px).mean(axis=1)[left], sides_of_corners(quads_px)[left]
    while left.size:
        kept.append(int(left[0]))
        apart = np.abs(centers - centers[0]) >= np.maximum(sides_px, sides_px[0]) / 2
        apart[0] = False
        left, centers, sides_px = left[apart], centers[apart], sides_px[apart]
    return np.array(kept, dtype=np.int64)


def _are_cut(image: Image, quads_px: Array) -> BoolArray:
    """Return which quadrilaterals (N, 4, 2) reach the border of an image: it may be their outline."""
    last_px = np.array(image.shape[::-1]) - 1
    return np.asarray(((quads_px < BORDER_PX) | (quads_px > last_px - BORDER_PX)).any(axis=(1, 2)))
