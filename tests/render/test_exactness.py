"""Markers as drawn against an exact reference that shares no code with the renderer.

The bounds are the project's: 0.5 grey levels at the worst pixel, 0.1 RMS over the cards' pixels, and 0.001 px
of bias for a perfect fit. Where the error comes from: nearest entries of the edge table (0.08 an edge), lines
beyond 3.4 σ left out (0.07), corners by a midpoint rule (0.1 at ρ = 0.3).
"""

from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest
from reference import BLACK, NODES, PIECE_PX, WHITE, card_levels, reference_light
from scipy.special import ndtr

from skyherd.render import (
    Camera,
    CameraPose,
    Distortion,
    Ground,
    Renderer,
    Sensor,
    Shot,
    footprint_m,
    project_markers,
)

DICTIONARY, GROUND = "4X4_50", 128.0
WORST, RMS = 0.5, 0.1
LENS = Distortion(k1=-0.25, k2=0.08, k3=-0.01, p1=0.002, p2=-0.001)


def make_renderer(psf_px: float = 0.8) -> Renderer:
    ground = Ground(0, kind="plain", mean=GROUND)
    return Renderer(DICTIONARY, 1.0, ground, Sensor(0.0, np.random.default_rng(0)), psf_px=psf_px)


def team(
    side_px: float, headings: np.ndarray, seed: int
) -> tuple[Camera, np.ndarray, np.ndarray, np.ndarray]:
    """A camera of focal length 500 px, and ids, positions and headings of markers in two rows before it."""
    rng = np.random.default_rng(seed)
    pitch = 2.1 * side_px + 12
    columns = (len(headings) + 1) // 2
    camera = Camera((int(columns * pitch), int(2 * pitch)), focal_px=500.0)
    places = np.array([(c - (columns - 1) / 2, r - 0.5) for r in (0, 1) for c in range(columns)])[
        : len(headings)
    ]
    places = places * pitch / side_px + rng.uniform(-0.5, 0.5, places.shape) / side_px
    return camera, rng.permutation(50)[: len(headings)], places, headings


def tilted(side_px: float, tilt_deg: float, about_deg: float) -> CameraPose:
    """The origin in the middle of the image, sides of `side_px` or so there, a focal length of 500 px."""
    height = 500.0 / side_px
    tilt_u, tilt_v = np.radians(tilt_deg) * np.cos(np.radians([about_deg, about_deg - 90]))
    pose = CameraPose((0.0, 0.0), height, 0.0, (tilt_u, tilt_v))
    x, y = footprint_m(Camera((1, 1), 500.0), pose).mean(axis=0)
    return replace(pose, position_m=(-x, -y))


def compare(light: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Largest difference, and RMS over the pixels that any card reaches."""
    difference = light - exact
    return float(np.abs(difference).max()), float(
        np.sqrt((difference[np.abs(exact - GROUND) > 0.01] ** 2).mean())
    )


# --- the reference itself ---


@pytest.mark.parametrize("heading", [0.0, 0.3, 2.2])
def test_reference_is_the_separable_card_without_tilt(heading):
    """There a card is a product of error functions along its sides, gathered over 8 x 8 points a pixel."""
    u, v, side, psf = 40.2, 39.7, 28.0, 0.5
    turn = side * np.array([np.cos(heading), np.sin(heading)])
    image_marker = np.array([[turn[0], turn[1], u], [turn[1], -turn[0], v], [0, 0, 1]])
    node, weight = np.polynomial.legendre.leggauss(8)
    at = (np.arange(80)[:, None] + node[None, :] / 2).ravel()
    du, dv = np.meshgrid(at - u, at - v)
    forward, right = du * np.cos(heading) + dv * np.sin(heading), dv * np.cos(heading) - du * np.sin(heading)
    lines = side / 6 * (np.arange(9) - 4)
    rows, columns = (-np.diff(ndtr((x[..., None] - lines) / psf), axis=-1) for x in (-forward, right))
    light = GROUND + (rows @ (card_levels(DICTIONARY, 7) - GROUND) * columns).sum(axis=-1)
    light = np.einsum(
        "aibj,i,j->ab",
        light.reshape(80, 8, 80, 8),
        weight / 2,
        weight / 2,
    )
    exact = reference_light(DICTIONARY, np.array([7]), image_marker[None], (80, 80), psf_px=psf)
    np.testing.assert_allclose(exact, light, rtol=0, atol=1e-5)


def slanted(side: float) -> np.ndarray:
    """A homography (3, 3) that no similarity is near."""
    return np.array([[side, 0.3 * side, 40.3], [0.2 * side, -0.8 * side, 39.6], [0.1, 0.15, 1.0]])


def test_reference_agrees_with_counted_points_for_homographies():
    """33 x 33 points a pixel, each of its cell's level, under a sampled aperture.

    An edge is known to half a point, 1/66 px: 200 / (sqrt(2 pi) 0.8) / 66 = 1.5 grey levels at worst, better
    by the root of the number of points along it: 0.15 in the mean square.
    """
    fine, psf = 33, 0.8
    line = (np.arange(80 * fine) + 0.5) / fine - 0.5
    forward, left, w = (a * line + b * line[:, None] + c for a, b, c in np.linalg.inv(slanted(25.0)))
    row, column = (np.floor(4 - 6 * x / w).astype(int) for x in (forward, left))
    inside = (row >= 0) & (row < 8) & (column >= 0) & (column < 8)
    ideal = np.where(inside, card_levels(DICTIONARY, 3)[row.clip(0, 7), column.clip(0, 7)], GROUND)
    away = line[None, :] - np.arange(80)[:, None]
    kernel = (ndtr((away + 0.5) / psf) - ndtr((away - 0.5) / psf)) / fine
    counted = kernel @ ideal @ kernel.T
    exact = reference_light(DICTIONARY, np.array([3]), slanted(25.0)[None], (80, 80), psf_px=psf)
    difference = (counted - exact)[8:-8, 8:-8]
    assert np.abs(difference).max() < 1.5
    assert np.sqrt((difference**2).mean()) < 0.15


def test_the_reference_has_converged():
    args = DICTIONARY, np.array([3]), slanted(25.0)[None], (80, 80)
    coarse, fine = (
        reference_light(*args, psf_px=0.5, piece_px=p, nodes=n) for p, n in ((PIECE_PX, NODES), (0.2, 8))
    )
    assert np.abs(coarse - fine).max() < 1e-5


# --- markers ---

HEADINGS = np.array([0.0, 0.2, np.pi / 4, 1.3, 2.9, -2.2])
LARGE = {(60.0, psf, tilt) for psf, tilt in ((0.5, 0.0), (0.8, 0.0), (0.8, 20.0), (1.5, 20.0))}
SIDES = (10.0, 20.0, 60.0)

LIGHT = [
    pytest.param(*each, marks=pytest.mark.slow if each in LARGE else ())
    for each in product(SIDES, (0.5, 0.8, 1.5), (0.0, 20.0))
]
"""Sides, blurs and tilts; of the large ones, which take most time, the sharpest tilted and the softest."""


def check_exact(side: float, psf: float, tilt: float) -> None:
    camera, ids, positions, headings = team(side, HEADINGS, int(10 * side))
    pose = tilted(side, tilt, 40.0)
    renderer = make_renderer(psf)
    truth = renderer.truth(Shot(camera, pose, ids, positions, headings))
    exact = reference_light(DICTIONARY, ids, truth.images_marker, camera.size_px, psf_px=psf)
    worst, rms = compare(renderer.light(Shot(camera, pose, ids, positions, headings)), exact)
    assert worst < WORST
    assert rms < RMS


@pytest.mark.parametrize(("side", "psf", "tilt"), LIGHT)
def test_light_is_right(side, psf, tilt):
    check_exact(side, psf, tilt)


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 5.0, 10.0, 15.0, 20.0])
@pytest.mark.parametrize("psf", [0.5, 0.65, 0.8, 1.0, 1.25, 1.5])
@pytest.mark.parametrize("side", [10.0, 11.0, 12.0, 14.0, 16.0, 20.0, 24.0, 30.0, 40.0, 60.0, 80.0, 120.0])
def test_light_is_right_at_every_size_blur_and_tilt(side, psf, tilt):
    check_exact(side, psf, tilt)


@pytest.mark.smoke
def test_a_blur_wrong_by_a_hundredth_would_be_noticed():
    """200 levels, 0.24 of them a σ at the steepest bend: 1 % is 0.5 grey. The check above can fail."""
    camera, ids, positions, headings = team(30.0, HEADINGS, 1)
    pose = tilted(30.0, 0.0, 0.0)
    truth = make_renderer().truth(Shot(camera, pose, ids, positions, headings))
    exact = reference_light(DICTIONARY, ids, truth.images_marker, camera.size_px, psf_px=0.8)
    worst, rms = compare(make_renderer(0.815).light(Shot(camera, pose, ids, positions, headings)), exact)
    assert worst > WORST
    assert rms > RMS


MOVES = np.zeros((4, 3, 3))
MOVES[0, 0, 2] = MOVES[1, 1, 2] = 1.0
MOVES[2, 1, 0], MOVES[2, 0, 1], MOVES[3, 0, 0], MOVES[3, 1, 1] = 1.0, -1.0, 1.0, 1.0


@pytest.mark.parametrize(
    ("side", "psf", "tilt"),
    [
        (10, 0.5, 0),
        (15, 0.8, 20),
        (33, 1.5, 0),
        *(pytest.param(*each, marks=pytest.mark.slow) for each in ((33, 0.5, 20), (60, 0.8, 15))),
    ],
)
def test_a_perfect_fit_has_no_bias(side, psf, tilt):
    """One Gauss-Newton step of the exact image from the true pose: u, v, heading, scale, as a fit would end.

    Errors are a hundredth of a pixel and less, so that the step is the fit's bias to second order.
    """
    camera, ids, positions, headings = team(float(side), HEADINGS, side)
    pose, renderer = tilted(float(side), tilt, -70.0), make_renderer(psf)
    truth = renderer.truth(Shot(camera, pose, ids, positions, headings))
    light = renderer.light(Shot(camera, pose, ids, positions, headings))

    def exact(image_marker: np.ndarray, index: int) -> np.ndarray:
        # A frame of one marker: the others' pixels do not depend on its pose.
        return reference_light(
            DICTIONARY, ids[index : index + 1], image_marker[None], camera.size_px, psf_px=psf
        )

    for index, image_marker in enumerate(truth.images_marker[:4]):
        center = truth.centers_px[index]
        near = (
            np.hypot(*(np.mgrid[: camera.size_px[1], : camera.size_px[0]][::-1] - center[:, None, None]))
            < 0.96 * side + 6
        )
        about = np.array([[1, 0, center[0]], [0, 1, center[1]], [0, 0, 1.0]])
        columns = []
        for number, move in enumerate(MOVES):
            step = 1e-3 if number < 2 else 1e-3 / side
            by = [
                about @ (np.eye(3) + sign * step * move) @ np.linalg.inv(about) @ image_marker
                for sign in (1, -1)
            ]
            columns.append((exact(by[0], index) - exact(by[1], index))[near] / 2 / step)
        bias = np.linalg.lstsq(
            np.column_stack(columns), (light - exact(image_marker, index))[near], rcond=None
        )[0]
        assert np.abs(bias[:2]).max() < 0.001, "u, v, px"
        assert abs(bias[2]) * side / 2 < 0.001, "the turn at the marker's edge, px"


def test_a_lens_is_drawn_through_as_opencv_has_it():
    """The reference's edges bent by `cv2.projectPoints`; worst pixel as without a lens."""
    camera = Camera((420, 320), 300.0, (215.0, 150.0), aspect=1.05, distortion=LENS)
    rng = np.random.default_rng(3)
    pose = CameraPose((0.1, -0.2), 12.0, 0.4, (0.15, -0.1))
    grid = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 2)), axis=-1).reshape(-1, 2)
    positions, headings, ids = (
        grid * 2.6 + rng.uniform(-0.3, 0.3, grid.shape),
        rng.uniform(-3, 3, 20),
        np.arange(20),
    )
    renderer = make_renderer()
    plain = Camera((420, 320), 300.0, (215.0, 150.0), aspect=1.05)
    images = project_markers(plain, pose, positions, headings, 1.0, 8 / 6).images_marker
    matrix = camera.intrinsic_matrix()

    def bend(points: np.ndarray) -> np.ndarray:
        rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(matrix).T
        none = np.zeros(3)
        order = np.array([LENS.k1, LENS.k2, LENS.p1, LENS.p2, LENS.k3])
        return cv2.projectPoints(rays, none, none, matrix, order)[0].reshape(-1, 2)

    exact = reference_light(DICTIONARY, ids, images, camera.size_px, psf_px=0.8, bend=bend)
    worst, rms = compare(renderer.light(Shot(camera, pose, ids, positions, headings)), exact)
    assert worst < WORST
    assert rms < RMS
    truth = renderer.truth(Shot(camera, pose, ids, positions, headings))
    centers = images[:, :2, 2] / images[:, 2:, 2]
    np.testing.assert_allclose(truth.centers_px, bend(centers), atol=1e-9)
    assert np.abs(truth.centers_px - centers).max() > 5, "the lens moves markers by pixels"


def test_markers_cut_by_the_border_are_the_whole_ones_cut():
    """The same scene in a larger image, whose principal point is moved as far: nothing else differs."""
    rng = np.random.default_rng(4)
    ids, positions, headings = np.arange(12), rng.uniform(-3, 3, (12, 2)) * 1.4, rng.uniform(-3, 3, 12)
    pose, renderer = CameraPose((0.0, 0.0), 10.0, 0.3, (0.1, 0.1)), make_renderer()
    small, large = Camera((200, 160), 250.0, (99.0, 79.0)), Camera((360, 320), 250.0, (179.0, 159.0))
    light = renderer.light(Shot(small, pose, ids, positions, headings))
    whole = renderer.light(Shot(large, pose, ids, positions, headings))
    np.testing.assert_allclose(
        light, whole[80:-80, 80:-80], atol=2 * 0.08, rtol=0, err_msg="but for the table's step"
    )
    truth = renderer.truth(Shot(small, pose, ids, positions, headings))
    cut = (truth.visible_fractions > 0) & (truth.visible_fractions < 1)
    assert cut.sum() >= 3, "the test has cut markers"


def test_later_markers_lie_over_earlier_ones():
    ids, headings = np.array([4, 9]), np.array([0.4, 1.5])
    positions = np.array([[0.0, 0.0], [0.5, 0.3]])
    camera, pose, renderer = Camera((120, 120), 400.0), CameraPose((0.0, 0.0), 10.0), make_renderer()
    truth = renderer.truth(Shot(camera, pose, ids, positions, headings))
    exact = reference_light(DICTIONARY, ids, truth.images_marker, camera.size_px, psf_px=0.8)
    assert compare(renderer.light(Shot(camera, pose, ids, positions, headings)), exact)[0] < 2 * WORST, (
        "two in one pixel"
    )


@pytest.mark.smoke
def test_white_and_black_are_the_markers_levels():
    pose, place = CameraPose((0.0, 0.0), 10.0, 0.2), np.array([[0.1, 0.0]])
    light = make_renderer().light(
        Shot(Camera((200, 160), 1200.0), pose, np.array([5]), place, np.array([0.3]))
    )
    assert light.max() == pytest.approx(WHITE, abs=0.01)
    assert light.min() == pytest.approx(BLACK, abs=0.01)
