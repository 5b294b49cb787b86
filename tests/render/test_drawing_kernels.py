"""Compiled drawing kernels against the formulas in double precision (`drawing_reference`)."""

import numpy as np
import pytest
from drawing_reference import painted_discs, painted_lattices

from skyherd.render import Camera, CameraPose, Distortion, Equidistant, Motion, Shutter
from skyherd.render.edge import FELT, PER_SIGMA, edge_spread
from skyherd.render.paint import framed, paint_discs, paint_lattices
from skyherd.render.view import View

SIZE_PX = (96, 72)
LEVELS = 200.0
"""Difference between the darkest and the lightest cell of these tests, grey levels."""

ENTRY = LEVELS / np.sqrt(2 * np.pi) / PER_SIGMA
"""Largest difference of a level if rounding selects a neighbouring entry of the edge table. A line at `FELT`,
included or not by rounding, contributes less."""

ROUNDING = 1e-3
"""Rounding of light and table in single precision: 1e-7 of some hundred levels, in some tens of sums."""

LENSES = {
    "pinhole": {},
    "barrel": {"aspect": 1.2, "distortion": Distortion(k1=-0.3, k2=0.05)},
    "fisheye": {"distortion": Equidistant()},
    "skewed": {"skew": 0.15},
}


def view(lens: str, tilt: float, rolling: bool) -> View:
    camera = Camera(SIZE_PX, focal_px=70.0, **LENSES[lens])
    pose = CameraPose((0.1, -0.2), 2.0, 0.4, (tilt, -tilt / 2))
    if not rolling:
        return View(camera, pose)
    motion = Motion(camera_mps=(1.5, -1.0, 0.5), yaw_rate_radps=2.0)
    return View(camera, pose, motion, Shutter(row_time_s=2e-3))


def shapes(count: int, size: float, rng: np.random.Generator) -> np.ndarray:
    """Return maps (N, 3, 3) from shapes of extent 1 around the origin to the ground, some out of view."""
    turn = rng.uniform(0, 2 * np.pi, count)
    scale, (x, y) = size * rng.uniform(0.6, 1.4, count), rng.uniform(-1.4, 1.4, (2, count))
    maps = np.zeros((count, 3, 3))
    maps[:, 0, :] = np.stack([scale * np.cos(turn), -scale * np.sin(turn), x], axis=-1)
    maps[:, 1, :] = np.stack([scale * np.sin(turn), scale * np.cos(turn), y], axis=-1)
    maps[:, 2, 2] = 1
    return maps


def canvas(kind: type, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(30, 230, SIZE_PX[::-1]).astype(kind)


def assert_equal_to_rounding(drawn: np.ndarray, exact: np.ndarray) -> None:
    """Assert equality up to rounding: one level of 8 bits, or one table entry of light, at few pixels."""
    off = np.abs(drawn.astype(float) - exact)
    if drawn.dtype == np.uint8:
        assert off.max() <= 1
        assert (off > 0).mean() < 0.01
    else:
        assert off.max() < ENTRY
        assert (off > ROUNDING).mean() < 0.01


CASES = pytest.mark.parametrize(
    ("lens", "tilt", "rolling", "psf_px", "kind"),
    [
        ("pinhole", 0.0, False, 0.8, np.uint8),
        ("pinhole", 0.0, False, 0.8, np.float32),
        ("pinhole", 0.5, False, 0.5, np.float32),
        ("pinhole", 0.3, True, 0.8, np.uint8),
        ("barrel", 0.2, False, 0.8, np.float32),
        ("barrel", 0.2, True, 1.4, np.float32),
        ("fisheye", 0.6, False, 0.4, np.float32),
        ("skewed", 0.1, False, 0.8, np.float32),
    ],
)


@CASES
@pytest.mark.parametrize("cells", [1, 8])
def test_grid_kernel_matches_the_formula(lens, tilt, rolling, psf_px, kind, cells):
    rng = np.random.default_rng(5)
    levels = rng.choice([30.0, 230.0], (7, cells, cells))
    ground = shapes(7, 0.7, rng) @ [[1 / cells, 0, -0.5], [0, 1 / cells, -0.5], [0, 0, 1]]
    images, spread = view(lens, tilt, rolling).images(lambda _: ground), edge_spread(psf_px)
    before = canvas(kind, rng)
    drawn = before.copy()
    paint_lattices(drawn, images, framed(levels), spread)
    exact = painted_lattices(before, images, levels, spread)
    assert np.abs(exact - before).max() > LEVELS / 2
    assert_equal_to_rounding(drawn, exact)


@CASES
def test_disc_kernel_matches_the_formula(lens, tilt, rolling, psf_px, kind):
    rng = np.random.default_rng(6)
    ground, levels = shapes(5, 0.4, rng), rng.uniform(30, 230, 5)
    images, spread = view(lens, tilt, rolling).images(lambda _: ground), edge_spread(psf_px)
    before = canvas(kind, rng)
    drawn = before.copy()
    paint_discs(drawn, images, levels, spread)
    exact = painted_discs(before, images, levels, spread)
    assert np.abs(exact - before).max() > LEVELS / 4
    assert_equal_to_rounding(drawn, exact)


def test_pixel_far_from_lines_has_its_cell_level():
    """At the centre of a cell wider than twice `FELT` σ a pixel has exactly the cell's level."""
    levels = np.array([[[30.0, 230.0], [230.0, 30.0]]])
    ground = np.array([[[1.0, 0, -1], [0, 1.0, -1], [0, 0, 1]]])
    images, spread = (
        View(Camera(SIZE_PX, 70.0), CameraPose((0.0, 0.0), 2.0, 0.0)).images(lambda _: ground),
        edge_spread(0.8),
    )
    cell_px = 70.0 / 2.0
    assert cell_px > 2 * FELT * spread.sigma_px + 2
    drawn = np.full(SIZE_PX[::-1], 128, np.float32)
    paint_lattices(drawn, images, framed(levels), spread)
    middle, half = np.array(SIZE_PX)[::-1] / 2, round(cell_px / 2)
    v, u = (middle - 0.5).astype(int)
    assert {drawn[v - half, u - half], drawn[v + half, u + half]} | {
        drawn[v - half, u + half],
        drawn[v + half, u - half],
    } == {30.0, 230.0}


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("psf_px", [0.3, 0.8])
def test_light_rounds_to_8_bits_without_clipping(lens, psf_px):
    rng = np.random.default_rng(3)
    ground = shapes(30, 0.3, rng) @ [[1 / 8, 0, -0.5], [0, 1 / 8, -0.5], [0, 0, 1]]
    drawn = np.full(SIZE_PX[::-1], 255, np.float32)
    images = view(lens, 0.6, True).images(lambda _: ground)
    paint_lattices(drawn, images, framed(rng.choice([0.0, 255.0], (30, 8, 8))), edge_spread(psf_px))
    assert drawn.min() > -0.5
    assert drawn.max() < 255.5
