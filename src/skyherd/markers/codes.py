"""Marker dictionaries larger than OpenCV's, for more than a thousand robots: linear codes.

The bits of a marker of n cells per side, row by row, are a word of n² bits. Let C be a linear code, closed
under bitwise exclusive or, that the eight symmetries of the square map onto itself. Its words form orbits
under these symmetries. One word is taken of each orbit of eight; words with a symmetry of their own are left
out. Any two of all rotated and mirrored copies then differ and are both words of C, and

    d = min over c in C, c ≠ 0, of weight(c)

is a minimum Hamming distance. It holds between any two markers at any rotation, between a marker and its own
rotations, and between markers and mirror images: a mirrored stream decodes nothing. The bases were found by
`benchmarks/search_dictionaries.py`; the words follow from them by exclusive or on any platform.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skyherd.geometry import BoolArray, IntArray

Words = npt.NDArray[np.uint64]
"""Words of a code, a bit for each cell."""


@dataclass(frozen=True)
class MarkerCode:
    """A generated dictionary: a linear code whose few basis words generate thousands of markers.

    Attributes:
        cells: bits along a marker's side, without the black border.
        size: number of markers.
        distance: least Hamming distance over all rotations and reflections.
        basis: words whose sums modulo 2 are the code; the first cell is the highest bit.
    """

    cells: int
    size: int
    distance: int
    basis: tuple[int, ...]


CODES = {
    "5X5_1900": MarkerCode(
        cells=5,
        size=1900,
        distance=5,
        basis=(
            0x10001A6,
            0x080038F,
            0x040091A,
            0x02000FE,
            0x01002CC,
            0x0080899,
            0x0040AD3,
            0x0020AE5,
            0x00108E8,
            0x00089C2,
            0x0004346,
            0x0002951,
            0x00012BF,
            0x000056C,
        ),
    ),
    "6X6_1900": MarkerCode(
        cells=6,
        size=1900,
        distance=10,
        basis=(
            0x80025B76F,
            0x40026BD36,
            0x201175C79,
            0x10103C9EE,
            0x0802581F6,
            0x04025B890,
            0x02117A224,
            0x01130FE08,
            0x00901191F,
            0x00515805A,
            0x0032463E0,
            0x000B6D32D,
            0x0007431F9,
            0x0000DDD0A,
        ),
    ),
    "6X6_7900": MarkerCode(
        cells=6,
        size=7900,
        distance=8,
        basis=(
            0x8000806F0,
            0x401025BE7,
            0x2002A56F9,
            0x1002965F9,
            0x0812A28B3,
            0x04023469B,
            0x021287B06,
            0x011207565,
            0x008094ABB,
            0x0042322A3,
            0x0032342E9,
            0x00080665E,
            0x000634B18,
            0x000187F8A,
            0x000054552,
            0x00000CCCC,
        ),
    ),
    "7X7_8000": MarkerCode(
        cells=7,
        size=8000,
        distance=12,
        basis=(
            0x100000A931B0B,
            0x08008E038AF56,
            0x04000780FAFC4,
            0x0200878444C34,
            0x0100030700C9A,
            0x00808A2E22CAA,
            0x0040002A65B68,
            0x002084C2AF829,
            0x00108AA73F90D,
            0x00080E232E87B,
            0x0004816645F18,
            0x00020EE5A48D9,
            0x00018E204DA24,
            0x00004569FB83D,
            0x00002229071D5,
            0x0000144507BE3,
        ),
    ),
}
"""Generated dictionaries by name: cells a side and number of markers. *Measured*: the bases were found by
`benchmarks/search_dictionaries.py`; the distances follow from them."""


def symmetries(cells: int) -> IntArray:
    """Return the symmetries of the square as permutations (8, n²) of its n² cells.

    Row k turns by k quarters; rows from 4 on are mirrored first.
    """
    index = np.arange(cells * cells).reshape(cells, cells)
    return np.array([np.rot90(side, k).ravel() for side in (index, index[:, ::-1]) for k in range(4)])


def span(basis: Sequence[int]) -> Words:
    """Return all words (2^k,) of a linear code: the sums modulo 2 of its k basis words."""
    words = np.zeros(1, np.uint64)
    for vector in basis:
        words = np.concatenate([words, words ^ np.uint64(vector)])
    return words


def word_bits(words: Words, count: int) -> BoolArray:
    """Return the lowest `count` bits (N, count) of words (N,), most significant first."""
    shifts = np.arange(count - 1, -1, -1, dtype=np.uint64)
    return np.asarray((words[:, None] >> shifts) & np.uint64(1), dtype=bool)


def code_bits(code: MarkerCode) -> BoolArray:
    """Return the white cells (N, n, n) of a generated dictionary's markers, without their black border.

    Of each orbit the least word is taken. Words whose cells change most often come first: they resemble dark
    clutter least, and their many edges give the most accurate pose.
    """
    cells = code.cells
    words = span(code.basis)
    bits = word_bits(words, cells * cells)
    weights = np.uint64(1) << np.arange(cells * cells - 1, -1, -1, dtype=np.uint64)
    images = np.stack([bits[:, turn] @ weights for turn in symmetries(cells)])
    first = words == images.min(axis=0)
    free = (images[1:] != words).all(axis=0)
    bits = bits[first & free].reshape(-1, cells, cells)
    changes = (bits[:, 1:] != bits[:, :-1]).sum(axis=(1, 2)) + (bits[..., 1:] != bits[..., :-1]).sum(
        axis=(1, 2)
    )
    return np.asarray(bits[np.lexsort((words[first & free], -changes))][: code.size])
