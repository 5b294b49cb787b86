"""Measure the time of a rendered frame, relative to one warp of a full 8-bit frame in the same run.

    python benchmarks/rendering.py            # table on stdout
    python benchmarks/rendering.py --quick

Frames show sixteen markers of 30 px, noise 2 and blur 0.8 px, over textured ground, on one thread. Times are
medians and, for busy machines, minima. `fixed` is a fixed camera over moving robots. The unit is one
`cv2.warpPerspective` of a frame of the same size, timed between the frames, so that other load affects both.
"""

import argparse
from collections.abc import Callable
from time import perf_counter

import cv2
import numpy as np

from skyherd.render import (
    Camera,
    CameraPose,
    Clutter,
    Distortion,
    Ground,
    Motion,
    Renderer,
    Sensor,
    Shot,
    Shutter,
)

DICTIONARY, MARKERS, SIDE_PX = "4X4_50", 16, 30.0
HEIGHT_M = 10.0
INSTANT = Shutter()
LENS = Distortion(k1=-0.2, k2=0.05, p1=0.001)
DrawFrame = Callable[[int], object]


def scene(size_px: tuple[int, int], frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return drifting positions (F, N, 2) on a jittered grid, in sides, and headings (F, N)."""
    rng = np.random.default_rng(1)
    cells = np.stack(np.meshgrid(np.arange(4) - 1.5, np.arange(4) - 1.5), axis=-1).reshape(-1, 2)
    room = np.array(size_px) / SIDE_PX / 4.6
    home = cells * room + rng.uniform(-0.3, 0.3, (MARKERS, 2)) * (room - 2)
    drift = np.cumsum(rng.normal(0, 0.01, (frames, MARKERS, 2)), axis=0)
    headings = rng.uniform(-np.pi, np.pi, MARKERS) + np.cumsum(rng.normal(0, 0.02, (frames, MARKERS)), axis=0)
    return home + drift, headings


def pose_at(frame: int, *, moves: bool = True, tilt_deg: float = 0.0) -> CameraPose:
    """Return the pose of a camera that moves and turns a little with each frame, or stands still."""
    step = 0.02 * frame if moves else 0.0
    return CameraPose((step, -0.7 * step), HEIGHT_M + 0.1 * step, 0.05 * step, (np.radians(tilt_deg), 0.0))


def make_frames(size_px: tuple[int, int], frames: int) -> dict[str, DrawFrame]:
    """Return the timed functions by name; each draws the frame of a number."""
    positions, headings = scene(size_px, frames)
    ids = np.arange(MARKERS)
    plain = Camera(size_px, focal_px=HEIGHT_M * SIDE_PX)
    lens = Camera(size_px, focal_px=HEIGHT_M * SIDE_PX, distortion=LENS)
    motion = Motion(camera_mps=(1.0, 0.5, 0.0))

    def draws(camera: Camera, renderer: Renderer, **pose: float) -> DrawFrame:
        still = bool(pose.pop("still", False))
        return lambda n: renderer.render(
            Shot(
                camera,
                pose_at(n, moves=not still, **pose),
                ids,
                positions[n],
                headings[n],
                motion=motion,
            )
        )

    def renderer(shutter: Shutter = INSTANT, clutter: Clutter | None = None, **sensor: float) -> Renderer:
        seeded = Sensor(2.0, np.random.default_rng(2), **sensor)
        return Renderer(DICTIONARY, 1.0, Ground(3, clutter=clutter), seeded, shutter=shutter)

    source = np.random.default_rng(4).integers(0, 256, (size_px[1] + 200, size_px[0] + 200), dtype=np.uint8)
    turn = np.array([[0.995, -0.09, 90.0], [0.09, 0.995, 10.0], [1e-6, 1e-6, 1.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    footprint_m2 = np.prod(size_px) / SIDE_PX**2
    return {
        "one warp": lambda _: cv2.warpPerspective(source, turn, size_px, flags=flags),
        "moving": draws(plain, renderer()),
        "fixed": draws(plain, renderer(), still=True),
        "tilted 15 deg": draws(plain, renderer(), tilt_deg=15.0),
        "clutter of 150": draws(plain, renderer(clutter=Clutter(5, 150 / footprint_m2, (0.5, 1.5)))),
        "lens": draws(lens, renderer()),
        "shot noise": draws(plain, renderer(shot=0.1)),
        "rolling shutter": draws(plain, renderer(Shutter(row_time_s=2e-5))),
        "motion blur 3 px": draws(plain, renderer(Shutter(exposure_s=0.09))),
    }


def measure(size_px: tuple[int, int], frames: int) -> dict[str, list[float]]:
    """Return the duration of each frame of each kind, measured in alternation, s."""
    timed = make_frames(size_px, frames)
    spent: dict[str, list[float]] = {name: [] for name in timed}
    for number in range(frames):
        for name, frame in timed.items():
            started = perf_counter()
            frame(number)
            spent[name].append(perf_counter() - started)
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="20 frames in place of 200")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    for size_px in ((800, 800), (1280, 960)):
        spent = measure(size_px, 20 if options.quick else 200)
        median, best = ({name: float(of(s)) for name, s in spent.items()} for of in (np.median, np.min))
        print(f"{size_px[0]}x{size_px[1]}, OpenCV {cv2.__version__}    ms  in warps   best ms  in warps")
        for name in spent:
            figures = ((of[name], of[name] / of["one warp"]) for of in (median, best))
            print(f"  {name:18s}" + "  ".join(f"{1e3 * ms:9.2f} {ratio:8.2f}" for ms, ratio in figures))


if __name__ == "__main__":
    main()
