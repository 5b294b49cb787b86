"""Measure detectors under the lens and processing stages of cameras, and print a table.

    python benchmarks/processed_pixels.py [DETECTOR,...]

The cells are those of the camera sweeps of `skyherd bench detectors`, with fewer images of each. Columns of
a detector: RMSE of position and of heading over the Cramér–Rao bound of the raw pixels, NEES of both if it
reports covariances, and recall. It takes some minutes.
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


def columns(rows: list[Row]) -> dict[str, list[str]]:
    """Return the columns of one detector: a title and a value for each cell."""
    measured = {"position": "ratio_px", "heading": "ratio_deg"}
    if any(row["nees"] is not None for row in rows):
        measured |= {"NEES, position": "nees", "NEES, heading": "nees_heading"}
    found = {
        title: ["–" if row[key] is None else f"{row[key]:.2f}" for row in rows]
        for title, key in measured.items()
    }
    return found | {"recall, %": [f"{100 * row['recall']:.1f}" for row in rows]}


def main(detectors: tuple[str, ...]) -> None:
    """Measure all cells and print a row for each."""
    named = cells()
    rows = measure_cells(Plan(detectors, "4X4_50", SEED), list(named.values()))
    header, body = ["camera"], [[label] for label in named]
    for number, name in enumerate(detectors):
        for title, values in columns(rows[number :: len(detectors)]).items():
            header.append(title if len(detectors) == 1 else f"{name}: {title}")
            for line, value in zip(body, values, strict=True):
                line.append(value)
    for line in header, ["---"] * len(header), *body:
        print(f"| {' | '.join(line)} |")


if __name__ == "__main__":
    main(tuple(sys.argv[1].split(",")) if len(sys.argv) > 1 else DETECTORS)
