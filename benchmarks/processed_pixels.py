"""Measure detectors through what lenses and processing of cameras do, and print a table.

    python benchmarks/processed_pixels.py [DETECTOR,...]

The cells are those of the camera sweeps of `skyherd bench detectors`, with fewer images of each: RMSE of
position / of heading over the Cramér–Rao bound of the raw pixels, NEES of the position / of the heading, and
recall. It takes some minutes.
"""

import sys
from dataclasses import replace

from skyherd.bench.detectors.design import CAMERA_SWEEPS, Cell
from skyherd.bench.execution import Plan, Row, measure_cells

CAMERAS, FRAMES, SEED = 4, 4, 5000
"""Of each cell: cameras, images of each, and the seed. Chosen: 256 markers a cell, so that a NEES of 1 is
measured to within 0.06 for positions and 0.09 for headings."""

DETECTORS = ("photometric",)


def cells() -> dict[str, Cell]:
    """Return the cells by what is done to their images; the first is raw."""
    raw = Cell(cameras=CAMERAS, frames=FRAMES)
    named = {"none: raw pixels": raw}
    for sweep in CAMERA_SWEEPS:
        for value in sweep.values:
            named[f"{sweep.label}: {value:g}"] = replace(raw, **{**sweep.fixed, sweep.key: value})
    return named


def entry(row: Row) -> str:
    """Return what one detector achieved in one cell."""
    ratios = f"{row['ratio_px']:.2f} / {row['ratio_deg']:.2f}"
    nees = "" if row["nees"] is None else f", {row['nees']:.2f} / {row['nees_heading']:.2f}"
    return f"{ratios}{nees}, {100 * row['recall']:.1f} %"


def main(detectors: tuple[str, ...]) -> None:
    """Measure and print a line for each cell."""
    named = cells()
    rows = measure_cells(Plan(detectors, "4X4_50", SEED), list(named.values()))
    print("| camera | " + " | ".join(detectors) + " |\n" + "| --- " * (1 + len(detectors)) + "|")
    for number, label in enumerate(named):
        here = rows[number * len(detectors) : (number + 1) * len(detectors)]
        print(f"| {label} | " + " | ".join(map(entry, here)) + " |", flush=True)


if __name__ == "__main__":
    main(tuple(sys.argv[1].split(",")) if len(sys.argv) > 1 else DETECTORS)
