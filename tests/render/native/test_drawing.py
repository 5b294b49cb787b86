"""Compiled drawing: equal bytes on all builds, the ground against its formula, and checks of arguments.

`tests/render/test_drawing_kernels.py` compares lattices and discs with their formulas.
"""

from dataclasses import replace

import numpy as np
import pytest
from drawing_reference import sampled_ground
from native_builds import builds

from skyherd.errors import InputError
from skyherd.render import (
    Camera,
    CameraPose,
    Clutter,
    Disc,
    Distortion,
    Equidistant,
    Ground,
    Motion,
    Quad,
    Renderer,
    Sensor,
    Shot,
    Shutter,
    paint,
)
from skyherd.render import ground as ground_module
from skyherd.render.edge import edge_spread
from skyherd.render.ground import APART
from skyherd.render.native.library import FlatShapes, Frame, declared, library
from skyherd.render.view import View

SIZE_PX = (230, 170)
SAMPLES = 128

VIEWS = {
    "vertical": ({}, 0.0, False),
    "tilted": ({}, 0.4, False),
    "lens": ({"distortion": Distortion(k1=-0.2, k2=0.03)}, 0.1, False),
    "rolling": ({}, 0.1, True),
    "rolling fisheye": ({"distortion": Equidistant()}, 0.5, True),
}


def view_of(name, size_px=SIZE_PX):
    lens, tilt, rolling = VIEWS[name]
    camera = Camera(size_px, focal_px=0.74 * size_px[0], **lens)
    pose = CameraPose((0.1, -0.2), 6.0, 0.4, (tilt, -tilt / 2))
    if not rolling:
        return View(camera, pose)
    return View(camera, pose, Motion((1.5, -1.0, 0.5), 1.0), Shutter(row_time_s=1e-3))


@pytest.fixture
def drawn_by(monkeypatch):
    """Return a function that draws a scene with one build of the library."""

    def draw(build, name, kind):
        for module in (paint, ground_module):
            monkeypatch.setattr(module, "library", lambda: build)
        view, rng = view_of(name), np.random.default_rng(4)
        clutter = Clutter(5, 0.3, (0.5, 1.5))
        sensor = Sensor(2.0, np.random.default_rng(2))
        renderer = Renderer("4X4_50", 0.8, Ground(3, clutter=clutter), sensor, shutter=view.shutter)
        places = rng.uniform(-3, 3, (12, 2)), rng.uniform(-np.pi, np.pi, 12)
        occluders = [Disc((0.5, 0.3), 0.6, 60.0), Quad([[1, 1], [2, 1.2], [1.9, 2], [1, 1.8]], 90.0)]
        shot = Shot(view.camera, view.pose, np.arange(12), *places, motion=view.motion, occluders=occluders)
        return getattr(renderer, kind)(shot)

    return draw


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("kind", ["render", "light"])
def test_builds_give_equal_bytes(drawn_by, name, kind):
    images = [drawn_by(build, name, kind) for build in builds("render", declared).values()]
    assert images[0].std() > 10
    assert {image.tobytes() for image in images} == {images[0].tobytes()}


def periodic(slope):
    """Return random samples (n, n) whose neighbours differ by at most `slope` grey levels."""
    n = SAMPLES
    spectrum = np.fft.rfft2(np.random.default_rng(1).standard_normal((n, n)))
    y, x = np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :]
    smooth = np.fft.irfft2(spectrum * np.exp(-2 * (8 * np.pi) ** 2 * (x**2 + y**2)))
    steepest = max(np.abs(np.roll(smooth, 1, axis) - smooth).max() for axis in (0, 1))
    return np.rint(128 + smooth * (slope - 1) / steepest).astype(np.uint8)


def paired(samples):
    wide = np.pad(samples, ((0, 1), (0, APART)), mode="wrap")
    return np.stack([wide[:-1], wide[1:]], axis=-1)


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize(("size_px", "metre_samples"), [(SIZE_PX, 20.0), (SIZE_PX, 60.0), ((1100, 30), 60.0)])
def test_ground_equals_formula_to_rounding(name, size_px, metre_samples):
    """The bound is half a level, and the slope times 1/512 (weights) and 0.004 (interpolated places)."""
    slope, images = 8, view_of(name, size_px).ground()
    samples = periodic(slope)
    scale = np.diag([metre_samples, metre_samples, 1.0])
    matrices = scale @ np.linalg.inv(images.matrices[:, 0])
    found = library().draw_ground(size_px, images.frame(), matrices, paired(samples))
    expected = sampled_ground(samples, size_px, images.frame(), matrices)
    off = np.abs(found - expected)
    assert expected.std() > 10
    assert off.max() <= 0.5 + 2 * slope * (1 / 512 + 0.004)
    assert np.sqrt((off**2).mean()) < 0.3, "rounding alone has an RMS of 0.289"


def test_ground_at_the_horizon_is_some_sample():
    """Places beyond the horizon and at infinity are not finite numbers of samples."""
    matrix = np.array([[[1.0, 0, 0], [0, 1, 0], [0, -1.0, 3]]])
    image = library().draw_ground((40, 8), Frame(np.zeros(8)), matrix, paired(periodic(8)))
    assert image.shape == (8, 40)


def shapes(count=2):
    corners = np.array([[2.0, 2.0], [9.0, 2.0], [9.0, 9.0], [2.0, 9.0]])
    matrix = np.array([[1 / 7, 0, -2 / 7], [0, 1 / 7, -2 / 7], [0, 0, 1.0]])
    return FlatShapes(np.tile(corners, (count, 1, 1)), np.tile(matrix, (1, count, 1, 1)), 3.0)


def draw(canvas=None, frame=None, flat=None, levels=None, spread=None):
    """Draw two squares on an image of 12 x 16 px, with some arguments replaced."""
    library().draw_lattices(
        np.zeros((12, 16), np.uint8) if canvas is None else canvas,
        frame or Frame(np.zeros(12)),
        flat or shapes(),
        np.pad(np.full((2, 1, 1), 200, np.float32), ((0, 0), (1, 1), (1, 1))) if levels is None else levels,
        spread or edge_spread(0.8),
    )


def read_only(array):
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    "arguments",
    [
        {"canvas": np.zeros((12, 16))},
        {"canvas": np.zeros((12, 32), np.uint8)[:, ::2]},
        {"canvas": np.zeros((12, 16, 1), np.uint8)},
        {"canvas": np.zeros((12, 0), np.uint8)},
        {"canvas": read_only(np.zeros((12, 16), np.uint8))},
        {"canvas": [[0]]},
        {"frame": Frame(np.zeros(11))},
        {"frame": Frame(np.zeros(12, np.float32))},
        {"frame": Frame(np.zeros(12), np.zeros((6, 191), np.float32))},
        {"frame": Frame(np.zeros(12), np.zeros((6, 192)))},
        {"flat": replace(shapes(), outlines_px=shapes().outlines_px[:, :2].copy())},
        {"flat": replace(shapes(), outlines_px=np.zeros((2, 17, 2)))},
        {"flat": replace(shapes(), outlines_px=np.zeros((2, 4)))},
        {"flat": replace(shapes(), matrices=shapes(3).matrices)},
        {"flat": replace(shapes(), matrices=np.zeros((2, 2, 3, 3)))},
        {"flat": replace(shapes(), matrices=np.zeros((1, 2, 3, 3), np.float32))},
        {"flat": replace(shapes(), margin_px=-1.0)},
        {"flat": replace(shapes(), margin_px=np.nan)},
        {"levels": np.zeros((2, 3, 3))},
        {"levels": np.zeros((1, 3, 3), np.float32)},
        {"levels": np.zeros((2, 2, 2), np.float32)},
        {"levels": np.zeros((2, 65, 65), np.float32)},
        {"levels": np.zeros((2, 3, 4), np.float32)},
        {"spread": replace(edge_spread(0.8), sigma_px=-1.0)},
        {"spread": replace(edge_spread(0.8), table=np.zeros(9, np.float32))},
    ],
)
def test_invalid_drawings_are_rejected(arguments):
    draw()
    with pytest.raises(InputError):
        draw(**arguments)


@pytest.mark.parametrize("levels", [np.zeros(2), np.zeros(3, np.float32), np.zeros((2, 1), np.float32)])
def test_invalid_levels_of_discs_are_rejected(levels):
    arguments = np.zeros((12, 16), np.uint8), Frame(np.zeros(12)), shapes()
    library().draw_discs(*arguments, np.zeros(2, np.float32), edge_spread(0.8))
    with pytest.raises(InputError, match="levels"):
        library().draw_discs(*arguments, levels, edge_spread(0.8))


@pytest.mark.parametrize(
    ("size_px", "matrices", "texture"),
    [
        ((16, 12), np.zeros((2, 3, 3)), np.zeros((8, 9, 2), np.uint8)),
        ((16, 12), np.zeros((3, 3)), np.zeros((8, 9, 2), np.uint8)),
        ((16, 12), np.eye(3)[None], np.zeros((8, 8, 2), np.uint8)),
        ((16, 12), np.eye(3)[None], np.zeros((6, 9, 2), np.uint8)),
        ((16, 12), np.eye(3)[None], np.zeros((1, 9, 2), np.uint8)),
        ((16, 12), np.eye(3)[None], np.zeros((8, 9), np.uint8)),
        ((16, 12), np.eye(3)[None], np.zeros((8, 9, 2))),
        ((0, 12), np.eye(3)[None], np.zeros((8, 9, 2), np.uint8)),
    ],
    ids=[
        "two instants",
        "one matrix",
        "no border",
        "no power of two",
        "one row",
        "no pairs",
        "float",
        "empty",
    ],
)
def test_invalid_grounds_are_rejected(size_px, matrices, texture):
    with pytest.raises(InputError):
        library().draw_ground(size_px, Frame(np.zeros(12)), matrices, texture)
