"""Measure the constant biases of detectors that are not ours, on rendered images.

    python benchmarks/peer_biases.py            # print them, by side and over all
    python benchmarks/peer_biases.py --write    # and store them where the package reads them

The position bias is the mean of u and v, which are equal. The side bias depends a little on the side, most
with SUBPIX. Its constant is the mean over the sides of this script.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.bench.detectors.scorer import match
from skyherd.bench.entrants import DEFAULT_DICTIONARY, dictionary_for
from skyherd.vision import PeerDetector, peer_names

SIDES_PX = (18.0, 24.0, 30.0, 45.0, 60.0, 80.0)
TABLE = Path(__file__).parent.parent / "vision" / "detectors" / "peer_biases.toml"


def measure(name: str, side_px: float, frames: int, seed: int) -> tuple[float, float, int]:
    """Return the mean error of u and v, the mean error of the side, and the number of markers found."""
    dictionary = dictionary_for(name, DEFAULT_DICTIONARY)
    detector = PeerDetector(name, dictionary, corrected=False)
    shifts, grows = [], []
    cell = Cell(side_px=side_px, noise=2.0, blur_px=0.8, cameras=4, frames=frames)
    for frame in rendered_frames(cell, dictionary, seed):
        seen = detector.detect(frame.image)
        answers, rows = match(frame, seen)
        shifts.append((seen.centers_px[answers] - frame.centers_px[rows]).ravel())
        grows.append(seen.sides_px[answers] - frame.sides_px[rows])
    shift, grow = np.concatenate(shifts), np.concatenate(grows)
    return float(shift.mean()), float(grow.mean()), int(grow.size)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=20, help="images of each of four cameras")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"store them in {TABLE}")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    text = (
        "# Constant biases of the peers, by `benchmarks/peer_biases.py --write`, at noise 2, blur 0.8 px:\n"
        f"# means over markers of {', '.join(f'{side:g}' for side in SIDES_PX)} px. "
        f"OpenCV {cv2.__version__}.\n"
    )
    print("detector          side_px  found  position bias px  side bias px")
    for name in peer_names():
        rows = [measure(name, side_px, options.frames, options.seed) for side_px in SIDES_PX]
        for side_px, (position, side, found) in zip(SIDES_PX, rows, strict=True):
            print(f"{name:16}  {side_px:7.0f}  {found:5d}  {position:+16.3f}  {side:+12.3f}", flush=True)
        position, side = (float(np.mean([row[k] for row in rows])) for k in (0, 1))
        print(f"{name:16}  {'all':>7}  {'':5}  {position:+16.3f}  {side:+12.3f}")
        text += f"\n[{name}]\nposition_bias_px = {position:.3f}\nside_bias_px = {side:.3f}\n"
    if options.write:
        TABLE.write_text(text, "utf-8")
        print(f"written: {TABLE}")


if __name__ == "__main__":
    main()
