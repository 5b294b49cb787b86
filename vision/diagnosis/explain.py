"""Why markers were not detected: every rejected candidate, with what was measured of it and a remedy.

Explaining is not detecting: this is a slow and thorough pass, for people who set up cameras and markers, over
what a detector left. Candidates (`candidates`) are read by correlation with all markers under several blurs
(`quad_reading`), so that blur, contrast and the nearest id are measured from the bits themselves. The first
limit that is broken, in the order of `Reason`, is the reason given (`reasons`): a marker of too few pixels
has wrong bits as well.
"""

from collections import Counter
from dataclasses import dataclass

import cv2
import numpy as np

from skyherd.geometry import Array
from skyherd.markers.dictionary import card_side
from skyherd.messages import Detections
from skyherd.vision.detectors.registry import create_detector
from skyherd.vision.diagnosis.candidates import bright_groups, cut_squares, dark_patches, dark_quads
from skyherd.vision.diagnosis.quad_reading import PROMISING, Reading, read_likely, read_quad
from skyherd.vision.diagnosis.reasons import (
    CERTAIN,
    ENOUGH_CELL_PX,
    Reason,
    describe,
    find_reason,
    is_cut,
    is_dark,
)
from skyherd.vision.grey import Image, check_grey

GROWTHS_PX = (0.5, 1.0)
"""By how much a contour is moved outwards and read again, px. Derived: thresholds lose up to a pixel of an
edge."""

REACH = 0.6
"""A candidate centred within this share of a detected card's side from its centre is part of that card.
Chosen: more than half, for candidates that reach over its edge."""

FRAME_BONUS = 0.3
"""Added to the rank of candidates that read without a fault or have a clear frame, a likeness. Chosen: more
than likenesses of markers in one place differ by."""

VISIBLE_EXPONENT = 0.25
"""Exponent of the share in the image in a candidate's rank. Chosen: a square half outside loses a sixth."""

GUESS, SURE, MIN_VISIBLE = 0.75, 0.93, 0.4
"""Likeness at first and second look, and share in the image, that make a guessed square a marker. Chosen
high, since many squares are guessed and chance is like some marker too."""


@dataclass(frozen=True)
class Rejection:
    """A candidate that is no detection, and why.

    Attributes:
        reason: what is wrong with it.
        reading: what was measured of it.
        words: the reason with its numbers, and what to do about it.
    """

    reason: Reason
    reading: Reading
    words: str

    @property
    def corners_px(self) -> Array:
        """Corners (4, 2), px, in order around the candidate; they may lie outside the image."""
        return self.reading.corners_px

    @property
    def center_px(self) -> Array:
        """Mean (2,) of the corners, px."""
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
    image = check_grey(image)
    if detections is None:
        detections = create_detector(dictionary=dictionary).detect(image)
    readings: list[Reading] = []
    for reading in sorted(_read_all(image, dictionary, detections), key=_rank, reverse=True):
        if not _is_part(reading, readings):
            readings.append(reading)
    exact = Counter([r.nearest_id for r in readings if r.wrong_bits == 0 and not r.mirrored])
    exact.update(detections.ids.tolist())
    rejections = []
    size_px = np.array([image.shape[1], image.shape[0]])
    for reading in readings:
        reason = find_reason(reading, size_px, again=exact[reading.nearest_id] > 1)
        if reason is Reason.NO_BITS and not is_dark(reading):
            continue
        rejections.append(Rejection(reason, reading, describe(reason, reading, dictionary)))
    return sorted(rejections, key=lambda rejection: rejection.reason is Reason.NO_BITS)


def _read_all(image: Image, dictionary: str, detections: Detections) -> list[Reading]:
    """Readings of all candidates that are apart from the detections.

    Squares that were guessed rather than seen count only if they read without a fault, and so do those that
    touch the border, whose outline may be the border itself.
    """
    size_px = np.array([image.shape[1], image.shape[0]])
    reach_px = REACH * card_side(dictionary) * detections.sides_px
    outlines = [*dark_quads(image, dictionary), *dark_patches(image)]
    guesses = [*cut_squares(image, dictionary), *bright_groups(image, dictionary)]
    outlines, guesses = (
        [quad for quad in quads if not _is_known(quad, detections.centers_px, reach_px)]
        for quads in (outlines, guesses)
    )
    seen = [_read_grown(image, quad, dictionary) for quad in outlines]
    whole = [reading for reading in seen if not is_cut(reading, size_px)]
    doubtful = [reading for reading in seen if is_cut(reading, size_px)]
    likely = (read_likely(image, quad, dictionary, GUESS) for quad in guesses)
    doubtful += [reading for reading in likely if reading is not None]
    return whole + [
        r for r in doubtful if r.likeness >= SURE and r.wrong_bits == 0 and r.visible >= MIN_VISIBLE
    ]


def _read_grown(image: Image, corners_px: Array, dictionary: str) -> Reading:
    """The most marker-like reading of a contour moved outwards: thresholds lose up to a pixel of an edge."""
    center = corners_px.mean(axis=0)
    reach = float(np.linalg.norm(corners_px - center, axis=1).mean()) / np.sqrt(2)
    readings = [read_quad(image, corners_px, dictionary)]
    if readings[0].likeness > PROMISING:
        readings += [
            read_quad(image, _grown(corners_px, 1 + grow / reach), dictionary) for grow in GROWTHS_PX
        ]
    return max(readings, key=_rank)


def _rank(reading: Reading) -> float:
    """How marker-like a reading is; of squares that share a place the highest stays."""
    exact = reading.likeness >= CERTAIN and reading.wrong_bits == 0
    frame = reading.framed and reading.cell_px[0] >= ENOUGH_CELL_PX and is_dark(reading)
    return float(reading.likeness * reading.visible**VISIBLE_EXPONENT + FRAME_BONUS * (exact or frame))


def _contains(corners_px: Array, point_px: Array) -> bool:
    return (
        cv2.pointPolygonTest(corners_px.astype(np.float32), (float(point_px[0]), float(point_px[1])), False)
        > 0
    )


def _grown(corners_px: Array, factor: float) -> Array:
    center = corners_px.mean(axis=0)
    return np.asarray(center + factor * (corners_px - center))


def _is_known(corners_px: Array, centers_px: Array, reach_px: Array) -> bool:
    """Whether a quadrilateral is, lies on, or surrounds one of the detections at centres (N, 2)."""
    center = corners_px.mean(axis=0)
    distances = np.linalg.norm(centers_px - center, axis=1)
    if (distances < reach_px).any():
        return True
    extent = np.linalg.norm(corners_px - center, axis=1).max()
    return any(_contains(corners_px, centers_px[k]) for k in np.flatnonzero(distances < extent))


def _is_part(reading: Reading, better: list[Reading]) -> bool:
    """Whether it shares its place with a better candidate."""
    center = reading.corners_px.mean(axis=0)
    return any(
        _contains(other.corners_px, center) or _contains(reading.corners_px, other.corners_px.mean(axis=0))
        for other in better
    )
