"""Search linear codes for `skyherd.markers.codes`: `search_dictionaries.py CELLS DIMENSION`.

Codes that are invariant under the symmetries of the square are built from random words and all their images.
A few random steps make the words more symmetric. The code with the largest minimum weight is kept. The search
for the shipped codes took 1 s (6 x 6, dimension 16), 15 s (5 x 5, 14), 40 s (6 x 6, 14) and 1 s (7 x 7, 16).
One or two more minutes found none better.
"""

import argparse
import time

import numpy as np

from skyherd.markers.codes import span, symmetries, word_bits

CHECKED = 12
"""Number of basis vectors that are spanned before the code is complete, to stop early. Chosen."""


def min_weight(basis: list[int], cells: int) -> int:
    """Return the minimum weight of the nonzero words of a code."""
    return int(word_bits(span(basis)[1:], cells**2).sum(axis=1).min())


def extend(basis: list[int], word: np.ndarray, turns: np.ndarray) -> list[int]:
    """Return the basis with all images of a word (n²,), in descending order."""
    basis = list(basis)
    for turn in turns:
        rest = int("".join("1" if bit else "0" for bit in word[turn]), 2)
        for vector in basis:
            rest = min(rest, rest ^ vector)
        if rest:
            basis = sorted([*basis, rest], reverse=True)
    return basis


def random_code(cells: int, dimension: int, beat: int, rng: np.random.Generator) -> list[int] | None:
    """Return a random invariant code, or None once it cannot exceed a minimum weight."""
    turns, basis = symmetries(cells), list[int]()
    while len(basis) < dimension:
        word = rng.integers(0, 2, cells**2).astype(bool)
        for _ in range(rng.integers(0, 4)):
            word = word ^ word[turns[rng.integers(1, 8)]]
        longer = extend(basis, word, turns)
        if len(longer) > dimension:
            continue
        basis = longer
        if len(basis) >= 6 and min_weight(basis[-CHECKED:], cells) <= beat:
            return None
    return basis


def main() -> None:
    """Read the command line and print every code that improves on all earlier ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cells", type=int)
    parser.add_argument("dimension", type=int)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    rng, best, end = np.random.default_rng(options.seed), 0, time.monotonic() + options.seconds
    while time.monotonic() < end:
        basis = random_code(options.cells, options.dimension, best, rng)
        if basis is None or (weight := min_weight(basis, options.cells)) <= best:
            continue
        best = weight
        print(f"distance {best}: {', '.join(hex(vector) for vector in basis)}", flush=True)


if __name__ == "__main__":
    main()
