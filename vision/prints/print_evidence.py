"""Evidence in an image for markers of every dictionary in every print: one search, all codes.

A print is how the markers of a dictionary are drawn and seen: the width of their border, black on white or
white on black, mirrored or not. The image and its negative are searched for dark squares, as the detector
does. In each square the cells of every grid are read as bits, and compared with all codes of that size.

With B bits of which w are wrong, p the probability of a wrong bit and C codes, turns included, the likelihood
ratio of a square to bits by chance is

    L = (2 (1 - p))^(B - w) (2 p)^w / C.

Its mean over random bits is 1 at most, as w is the least over all codes and C sums over them. Squares of one
place are not independent; their mean of L has the same bound. Of N places that have the border of a print, an
unknown share q shows markers. The evidence for a dictionary in a print is `log mean_q Π (1 - q + q L)`. By
chance the mean of this product is again 1 at most, so that evidence of E or more occurs in at most `exp(-E)`
of images of random bits (Markov's inequality). Drawn squares are not random: the detector has to confirm
the markers.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import chain
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray, to_complex
from skyherd.markers.dictionary import (
    MAX_BORDER_BITS,
    all_marker_cells,
    dictionary_names,
    dictionary_size,
    load_dictionary,
    sides_of_corners,
)
from skyherd.vision.grey import Image
from skyherd.vision.photometric.candidates import overlaps
from skyherd.vision.search.decode import MIN_CELL_DEVIATION, read_cells
from skyherd.vision.search.quads import find_quads, find_small_quads

WRONG_BIT = 0.05
"""Probability that a bit is read wrongly. Chosen: a marker of 4X4_50 stays likelier than chance with one
wrong bit, one of 36h11 with five."""

MAX_WRONG_BORDER = 0.15
"""Largest share of the border's cells that may be light. Chosen: glare on three of 20 cells."""

WHITE_PERCENTILE = 85
"""Percentile of the inner cells that is taken as white. Chosen: at least an eighth of a marker's bits are
white, and the brightest few may be glare."""

SHARES = tuple(2.0**-k for k in range(9))
"""Shares of places that show markers, with equal prior probability. Chosen: from all to one in 256."""


class MarkerPrint(NamedTuple):
    """Print of markers.

    Attributes:
        border_bits: width of their black border, in cells.
        inverted: whether they are white on black.
        mirrored: whether the image shows them mirrored.
    """

    border_bits: int = 1
    inverted: bool = False
    mirrored: bool = False


ALL_PRINTS = tuple(
    MarkerPrint(border_bits, inverted, mirrored)
    for mirrored in (False, True)
    for inverted in (False, True)
    for border_bits in range(1, MAX_BORDER_BITS + 1)
)
"""All prints; of those with equal evidence the first is preferred."""


class PrintEvidence(NamedTuple):
    """Evidence in an image for markers of one dictionary in one print.

    Attributes:
        dictionary: its name.
        kind: the print.
        log_evidence: as the module defines it.
    """

    dictionary: str
    kind: MarkerPrint
    log_evidence: float


class PrintSearch:
    """One search of an image for dark squares, and one of its negative for light ones, for all prints.

    Args:
        image: grey, (height, width).
        prints: to consider.
    """

    def __init__(self, image: Image, prints: Iterable[MarkerPrint]) -> None:
        self._prints, self._seen = list(prints), dict[bool, tuple[Image, Array]]()
        for inverted in sorted({kind.inverted for kind in self._prints}):
            seen = np.asarray(cv2.bitwise_not(image), dtype=np.uint8) if inverted else image
            quads = np.concatenate([find_quads(seen), find_small_quads(seen, np.zeros((0, 4, 2)))])
            self._seen[inverted] = seen, quads

    def ranked(self) -> list[PrintEvidence]:
        """Return the evidence for the likeliest dictionary of each print and size of code, descending.

        A mirrored print is left out where the same print as it is explains the squares as well.
        """
        ranked = list[PrintEvidence]()
        for border_bits, inverted in sorted({kind[:2] for kind in self._prints}, key=lambda two: two[::-1]):
            kinds = [kind for kind in self._prints if kind[:2] == (border_bits, inverted)]
            for cells in _series_by_size():
                squares = _read_squares(*self._seen[inverted], cells, border_bits)
                if len(squares.bits):
                    given = [_best_of_size(squares, cells, kind) for kind in kinds]
                    plain = max((one[2] for one in given if not one.kind.mirrored), default=-np.inf)
                    ranked += [one for one in given if not one.kind.mirrored or one.log_evidence > plain]
        return sorted(ranked, key=lambda evidence: -evidence.log_evidence)

    def likely_squares(self, there: PrintEvidence) -> tuple[Image, Array]:
        """Return the image in which markers of a print are black, and the squares likely to be these.

        Args:
            there: a print with evidence.

        Returns:
            The image or its negative, flipped if the print is mirrored, and the corners (N, 4, 2), px, of
            squares in it that are likelier markers than chance, clockwise.
        """
        seen, quads = self._seen[there.kind.inverted]
        cells = int(load_dictionary(there.dictionary).markerSize)
        squares = _read_squares(seen, quads, cells, there.kind.border_bits)
        codes = _codes(there.dictionary, mirrored=there.kind.mirrored)
        ratios = squares.log_ratios((squares.bits @ codes.T).max(axis=1), len(codes))
        likely = squares.corners_px[ratios > 0]
        if not there.kind.mirrored:
            return seen, likely
        return np.ascontiguousarray(seen[:, ::-1]), _flipped(likely, seen.shape[1])


def _flipped(quads_px: Array, width: int) -> Array:
    """Return the corners (N, 4, 2), px, in an image of a width that is flipped left to right, clockwise."""
    return quads_px[:, ::-1] * (-1.0, 1.0) + (width - 1.0, 0.0)


def larger_of_series(dictionary: str) -> tuple[str, ...]:
    """Return the dictionaries that have all markers of a dictionary and more, in ascending size."""
    for names in chain.from_iterable(_series_by_size().values()):
        if dictionary in names:
            return names[names.index(dictionary) + 1 :]
    return ()


@dataclass(frozen=True)
class _Squares:
    """Bits of N squares with a dark border.

    Attributes:
        bits: (M, B) different readings: 1 where a cell is white, -1 where it is black, row by row from
            corner 0.
        readings: (N,) row of each square's bits.
        places: (N,) number of each square's place, from 0; squares that overlap share a place.
        corners_px: (N, 4, 2) of the squares, clockwise.
    """

    bits: npt.NDArray[np.float32]
    readings: IntArray
    places: IntArray
    corners_px: Array

    def log_ratios(self, agreement: Array, codes: int) -> Array:
        """Return the log likelihood ratios (N,) of the squares as markers to bits by chance.

        Args:
            agreement: (M,) greatest inner product of each reading with a code.
            codes: number of codes, in all turns.
        """
        bits = self.bits.shape[1]
        return _log_ratios((bits - agreement) / 2, bits, codes)[self.readings]


def _read_squares(image: Image, quads_px: Array, cells: int, border_bits: int) -> _Squares:
    """Return the squares with a dark border of a width, and the bits of their inner cells."""
    n = cells + 2 * border_bits
    levels = read_cells(image, quads_px, n)
    is_border = np.ones((n, n), dtype=bool)
    is_border[border_bits:-border_bits, border_bits:-border_bits] = False
    outer, inner = levels[:, is_border.ravel()], levels[:, ~is_border.ravel()]
    black, white = np.median(outer, axis=1), np.percentile(inner, WHITE_PERCENTILE, axis=1)
    middle = np.asarray(black + white)[:, None] / 2
    dark = ((outer > middle).mean(axis=1) <= MAX_WRONG_BORDER) & (levels.std(axis=1) >= MIN_CELL_DEVIATION)
    bits = np.where(inner[dark] > middle[dark], 1, -1).astype(np.float32)
    different, readings = np.unique(bits, axis=0, return_inverse=True)
    return _Squares(different, readings.ravel(), _places(quads_px[dark]), quads_px[dark])


def _places(quads_px: Array) -> IntArray:
    """Return the number (N,) of the place of each quadrilateral (N, 4, 2); those of a place overlap."""
    centers, sides_px = to_complex(quads_px).mean(axis=1), sides_of_corners(quads_px)
    places, count = np.full(len(quads_px), -1), 0
    for row in range(len(quads_px)):
        if places[row] < 0:
            places[overlaps(centers[row], sides_px[row], centers, sides_px) & (places < 0)] = count
            count += 1
    return places


def _best_of_size(squares: _Squares, cells: int, kind: MarkerPrint) -> PrintEvidence:
    """Return the evidence for the best dictionary of a size of code."""
    given = [_of_series(squares, names, kind) for names in _series_by_size()[cells]]
    return max(given, key=lambda evidence: evidence.log_evidence)


def _of_series(squares: _Squares, names: tuple[str, ...], kind: MarkerPrint) -> PrintEvidence:
    """Return the evidence for the best of dictionaries that begin with the same markers, smallest first."""
    count = dictionary_size(names[-1])
    codes = _codes(names[-1], mirrored=kind.mirrored)
    agreement = (squares.bits @ codes.T).reshape(len(squares.bits), 4, count)
    best, greatest, compared = [], np.full(len(squares.bits), -np.inf), 0
    for name in names:
        size = dictionary_size(name)
        greatest = np.maximum(greatest, agreement[:, :, compared:size].max(axis=2).max(axis=1))
        compared = size
        ratios = squares.log_ratios(greatest, 4 * size)
        best.append(PrintEvidence(name, kind, _log_evidence(ratios, squares.places)))
    return max(best, key=lambda evidence: evidence.log_evidence)


def _log_ratios(wrong: Array, bits: int, codes: int) -> Array:
    """Return the log likelihood ratios (N,) of squares with wrong bits (N,) to bits by chance."""
    right, off = math.log(2 * (1 - WRONG_BIT)), math.log(2 * WRONG_BIT)
    return np.asarray((bits - wrong) * right + wrong * off - math.log(codes))


def _log_evidence(ratios: Array, places: IntArray) -> float:
    """Return the log evidence of squares with log likelihood ratios (N,) at places (N,), N of 1 or more.

    The squares of one place are one observation, by the mean of their ratios.
    """
    sums = np.full(places.max() + 1, -np.inf)
    np.logaddexp.at(sums, places, ratios)
    means = sums - np.log(np.bincount(places))
    shares = np.array(SHARES)[:, None]
    with np.errstate(divide="ignore"):  # all squares may be markers
        products = np.logaddexp(np.log1p(-shares), np.log(shares) + means).sum(axis=1)
    return float(np.logaddexp.reduce(products) - math.log(len(SHARES)))


@lru_cache(maxsize=32)
def _codes(name: str, *, mirrored: bool) -> npt.NDArray[np.float32]:
    """Return the bits (4 D, B) of all markers in four turns, turn by turn, as 1 and -1."""
    cells = all_marker_cells(name)[:, 1:-1, 1:-1]
    cells = cells[:, :, ::-1] if mirrored else cells
    turned = np.concatenate([np.rot90(cells, turn, (1, 2)) for turn in range(4)])
    return np.where(turned, 1, -1).astype(np.float32).reshape(len(turned), -1)


@cache
def _series_by_size() -> dict[int, list[tuple[str, ...]]]:
    """Return the dictionaries by bits along a side, in series that begin with the same markers.

    Of names that differ in capitals alone one is kept. The dictionaries of a series are in ascending size.
    """
    series: dict[tuple[int, bytes], list[str]] = {}
    for name in {name.lower(): name for name in dictionary_names()}.values():
        key = int(load_dictionary(name).markerSize), all_marker_cells(name)[0].tobytes()
        series.setdefault(key, []).append(name)
    by_size: dict[int, list[tuple[str, ...]]] = {}
    for (cells, _), names in sorted(series.items()):
        by_size.setdefault(cells, []).append(tuple(sorted(names, key=dictionary_size)))
    return by_size
