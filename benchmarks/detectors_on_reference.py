"""Run the benchmark's grid and tilts on frames from the tests' analytic reference instead of our renderer.

    python benchmarks/detectors_on_reference.py                     # about six minutes on two cores
    python benchmarks/detectors_on_reference.py --out runs/reference --detectors photometric,opencv

The reference (`tests/helpers/reference.py`) computes the light at every pixel without `skyherd.render`. A
detector must reach the same accuracy on these frames. Marker positions and ground truth come from the
renderer's projection, which the tests compare with OpenCV's. The reference has fixed levels and no motion,
occlusion or uneven light.
"""

import argparse
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "helpers"))

from reference import reference_light

from skyherd.bench.detectors.design import GRID, Cell
from skyherd.bench.detectors.frames import LabelledFrame, make_frame, marker_bounds
from skyherd.bench.detectors.page import write_outputs
from skyherd.bench.detectors.scene import camera_shots
from skyherd.bench.entrants import DEFAULT_DICTIONARY, REFERENCE
from skyherd.bench.execution import Plan, measure_cells
from skyherd.bench.result import Result, environment
from skyherd.markers.dictionary import card_side
from skyherd.render import project_markers

SIDES_PX = (14.0, 16.0, 20.0, 30.0, 60.0, 100.0)
NOISES = (2.0, 5.0, 10.0)
TILTS_DEG = (5.0, 15.0)


def reference_frames(cell: Cell, dictionary: str, seed: int) -> Iterator[LabelledFrame]:
    """Yield the frames of a cell from the reference, over a smooth random ground."""
    for unit in range(cell.cameras):
        layout, rng = (np.random.default_rng([seed, unit, use]) for use in range(2))
        ground: np.ndarray | None = None
        for shot in camera_shots(cell, dictionary, unit, layout):
            if ground is None:
                ground = gaussian_filter(rng.standard_normal(shot.camera.size_px[::-1]), 4.0)
                ground *= 12.0 / ground.std()
            truth = project_markers(
                shot.camera,
                shot.pose,
                shot.positions_m,
                shot.headings_rad,
                1.0,
                card_side(dictionary),
                ids=shot.ids,
            )
            light = reference_light(
                dictionary,
                truth.ids,
                truth.images_marker,
                shot.camera.size_px,
                psf_px=shot.blur_px,
                ground=128.0 + ground,
            )
            light += cell.noise * rng.standard_normal(light.shape)
            image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
            yield make_frame(shot, image, truth, marker_bounds(cell, dictionary, shot.blur_px, truth))


def cells(frames: int) -> list[Cell]:
    base = Cell(cameras=6, frames=frames)
    grid = [replace(base, sweep=GRID, side_px=side, noise=noise) for noise in NOISES for side in SIDES_PX]
    return [base, *grid, *(replace(base, sweep="tilt", tilt_deg=tilt) for tilt in TILTS_DEG)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--detectors", default=f"photometric,{REFERENCE}", help="names, with commas between")
    parser.add_argument("--frames", type=int, default=2, help="images of each of six cameras in a cell")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, help="folder for bench.json, page and figures")
    options = parser.parse_args()
    plan = Plan(
        tuple(options.detectors.split(",")), DEFAULT_DICTIONARY, options.seed, source=reference_frames
    )
    rows = measure_cells(plan, cells(options.frames), jobs=options.jobs)
    print("detector          side  noise  tilt  recall  position/bound  heading/bound  NEES u, v, heading")
    for row in rows:
        ratios, nees = (
            "  ".join("–" if row[key] is None else f"{row[key]:.2f}" for key in keys)
            for keys in (("ratio_px", "ratio_deg"), ("nees_u", "nees_v", "nees_heading"))
        )
        print(
            f"{row['detector']:16} {row['side_px']:5g} {row['noise']:6g} {row['tilt_deg']:5g} "
            f"{row['recall']:7.3f}  {ratios:>22}  {nees:>22}"
        )
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        asked = environment(source="tests/helpers/reference.py", seed=options.seed)
        result = Result(asked, rows, [])
        result.write(options.out)
        print(f"see {write_outputs(result, options.out)}")


if __name__ == "__main__":
    main()
