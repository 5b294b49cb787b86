"""Processor time of the compiled drawing by build, and of the ground by OpenCV, in alternation.

    python benchmarks/drawing_time.py

OpenCV draws the ground by warpAffine, by warpPerspective, and through a lens by remap, with places of the
pixels from NumPy. The cards are sixteen markers of 28 px. Images are 800x800, on one thread. Times are
minima, since other load on the machine only adds time.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "helpers"))

from native_builds import builds

from skyherd.geometry import inverse
from skyherd.render import Camera, CameraPose, Distortion, Ground, paint
from skyherd.render.edge import edge_spread
from skyherd.render.native.library import declared
from skyherd.render.view import ShapeImages, View

SIZE_PX, FOCAL_PX, HEIGHT_M, REPEATS = (800, 800), 500.0, 18.0, 30
LENS = Distortion(k1=-0.2, k2=0.05)
FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
Drawing = Callable[[], object]


def view(tilt_deg: float = 0.0, lens: Distortion | None = None) -> View:
    camera = Camera(SIZE_PX, FOCAL_PX, distortion=lens or Distortion())
    return View(camera, CameraPose((0.0, 0.0), HEIGHT_M, 0.4, (np.radians(tilt_deg), 0.0)))


def opencv_ground(images: ShapeImages, laid: np.ndarray, matrix: np.ndarray) -> Drawing:
    """Return the drawing of a repeated texture by OpenCV."""
    lens = images.lens()
    if lens is not None:
        v, u = np.mgrid[: SIZE_PX[1], : SIZE_PX[0]].astype(np.float32)
        m = matrix.astype(np.float32)

        def remap() -> object:
            column, row = (p + field.reshape(p.shape) for p, field in zip((u, v), lens.fields, strict=False))
            x, y, w = (m[i, 0] * column + m[i, 1] * row + m[i, 2] for i in range(3))
            return cv2.remap(laid, x / w, y / w, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)

        return remap
    if np.abs(matrix[2, :2]).max() < 1e-12:
        return lambda: cv2.warpAffine(laid, matrix[:2], SIZE_PX, flags=FLAGS, borderMode=cv2.BORDER_WRAP)
    return lambda: cv2.warpPerspective(laid, matrix, SIZE_PX, flags=FLAGS, borderMode=cv2.BORDER_WRAP)


def ground_drawings(seen: View) -> dict[str, Drawing]:
    """Return the drawings of the ground by OpenCV and by each build."""
    images = seen.ground()
    texture, sample_ground = Ground(3)._choose(images.matrices[0, 0], SIZE_PX)
    matrices = sample_ground @ inverse(images.matrices[:, 0])
    # The texture is repeated, with a row pitch that is no power of two, and the view moved into it.
    n = len(texture)
    laid = np.empty((3 * n, 3 * n + 64), dtype=np.uint8)[:, : 3 * n]
    laid[:] = np.tile(texture[:, :n, 0], (3, 3))
    near = np.array([[1.0, 0.0, n], [0.0, 1.0, n], [0.0, 0.0, 1.0]]) @ matrices[0]
    drawings = {"OpenCV": opencv_ground(images, laid, near / near[2, 2])}
    for level, library in builds("render", declared).items():
        drawings[f"v{level}"] = lambda library=library: library.draw_ground(
            SIZE_PX, images.frame(), matrices, texture
        )
    return drawings


def card_drawings(seen: View) -> dict[str, Drawing]:
    """Return the drawings of sixteen cards of 8 x 8 cells by each build."""
    rng = np.random.default_rng(1)
    turn, (x, y) = np.exp(1j * rng.uniform(0, 7, 16)), rng.uniform(-11, 11, (2, 16))
    ground = np.zeros((16, 3, 3))
    ground[:, 0] = np.stack([turn.real, -turn.imag, x], axis=-1)
    ground[:, 1] = np.stack([turn.imag, turn.real, y], axis=-1)
    ground[:, 2, 2] = 1
    images = seen.images(lambda _: ground @ [[1 / 8, 0, -0.5], [0, 1 / 8, -0.5], [0, 0, 1]])
    levels, spread = rng.choice([30.0, 230.0], (16, 8, 8)), edge_spread(0.8)
    canvas = np.full(SIZE_PX[::-1], 128, dtype=np.uint8)
    corners = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]])
    numbers, shapes = paint._in_view(images, corners, spread)
    cards = paint.framed(levels)[numbers]
    drawings: dict[str, Drawing] = {}
    for level, library in builds("render", declared).items():
        drawings[f"v{level}"] = lambda library=library: library.draw_lattices(
            canvas, images.frame(), shapes, cards, spread
        )
    return drawings


def least_ms(drawings: dict[str, Drawing], repeats: int) -> dict[str, float]:
    """Return the least processor times, measured in alternation, ms."""
    spent: dict[str, list[float]] = {name: [] for name in drawings}
    for _ in range(repeats + 1):  # the first one warms up
        for name, draw in drawings.items():
            begin = time.process_time()
            draw()
            spent[name].append(1000 * (time.process_time() - begin))
    return {name: float(min(times[1:])) for name, times in spent.items()}


def main() -> None:
    cv2.setNumThreads(1)
    views = {"vertical": view(), "tilted 15 deg": view(15.0), "lens": view(lens=LENS)}
    rows = {f"ground, {name}": ground_drawings(seen) for name, seen in views.items()}
    rows |= {f"cards, {name}": card_drawings(seen) for name, seen in views.items()}
    for row, drawings in rows.items():
        times = least_ms(drawings, REPEATS)
        best = list(times.values())[-1]
        ratio = f"   OpenCV / best {times['OpenCV'] / best:.2f}" if "OpenCV" in times else ""
        print(f"{row:24}" + "  ".join(f"{name} {spent:.2f} ms" for name, spent in times.items()) + ratio)


if __name__ == "__main__":
    main()
