"""Detection of dark quadrilaterals: recall, corner errors, touching squares, and noise."""

import cv2
import numpy as np
import pytest
from search_reference import is_quad

from skyherd.geometry import SQUARE_CORNERS, to_complex, to_points
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.search.quads import MIN_QUAD_SIDE_PX, SHRINKS, find_quads

HEADINGS = {"upright": 0.0, "a little turned": 0.02, "diagonal": np.pi / 4, "any": None}
ROWS = 4


def scene(place_markers, draw_markers, rng, side_px, heading=None, camera=None, noise=5.0, step=None):
    """Return an image of 16 markers and their corners (16, 4), u + iv, px.

    `camera` (3, 3) is a homography of the flat image. The markers are `step` px apart, by default 2.2 sides
    and at least 40 px.
    """
    step = max(2.2 * side_px, 40.0) if step is None else step
    grid = (np.arange(ROWS) + 0.5)[:, None] + 1j * (np.arange(ROWS) + 0.5)
    centers = step * grid.ravel() + rng.uniform(-0.5, 0.5, 16) + 1j * rng.uniform(-0.5, 0.5, 16)
    headings = rng.uniform(-np.pi, np.pi, 16) if heading is None else heading + np.pi / 2 * np.arange(16)
    matrices = place_markers(centers, headings, side_px)
    if camera is not None:
        matrices = camera @ matrices
    size = int(step * ROWS)
    image = draw_markers(matrices, rng.permutation(50)[:16], (size, size), rng, noise=noise)
    square = np.concatenate([to_points(SQUARE_CORNERS), np.ones((4, 1))], axis=1)
    corners = square @ matrices.transpose(0, 2, 1)
    return image, to_complex(corners[..., :2] / corners[..., 2:])


def match(quads, corners):
    """Return the corner errors (N, 4), px, of the quadrilateral nearest to each marker, or infinity."""
    if not len(quads):
        return np.full(corners.shape, np.inf)
    turned = np.concatenate([np.roll(to_complex(quads), turn, axis=1) for turn in range(4)])
    off = np.abs(turned[None] - corners[:, None])
    nearest = off.max(axis=2).argmin(axis=1)
    return off[np.arange(len(corners)), nearest]


@pytest.mark.parametrize("heading", HEADINGS.values(), ids=HEADINGS)
@pytest.mark.parametrize("side_px", [14, 18, 24, 40, 80])
def test_every_marker_has_a_quad_with_corners_within_2_px(place_markers, draw_markers, side_px, heading):
    """The fit converges from errors of up to two pixels.

    The RMS limit is the rounding of a boundary to whole pixels. It has the same sign along an upright side:
    at most half a pixel along each axis, 0.7 px in total.
    """
    rng = np.random.default_rng([1, side_px])
    errors = []
    for _ in range(3):
        image, corners = scene(place_markers, draw_markers, rng, side_px, heading)
        errors.append(match(find_quads(image), corners))
    worst = np.concatenate(errors).max(axis=1)
    assert worst.max() < 2.0, np.sort(worst)[-5:]
    assert np.sqrt((np.concatenate(errors) ** 2).mean()) < 0.7


@pytest.mark.parametrize("seed", range(4))
def test_markers_under_perspective_have_quads(place_markers, draw_markers, seed):
    """Tilts of about 20 degrees: a horizon at 800-1600 px, an anisotropy of 0.1."""
    rng = np.random.default_rng([2, seed])
    horizon = np.exp(2j * np.pi * rng.uniform()) / rng.uniform(800, 1600)
    anisotropy = 0.1 * np.exp(2j * np.pi * rng.uniform())
    middle = 132 * (1 + 1j)
    plane = LocalHomographies(*(np.array([z], dtype=complex) for z in (middle, 1.0, anisotropy, horizon)))
    square = 100 * SQUARE_CORNERS
    seen = to_points(plane.images(square)[0])
    camera = cv2.getPerspectiveTransform(
        to_points(square + middle).astype(np.float32), seen.astype(np.float32)
    )
    image, corners = scene(place_markers, draw_markers, rng, 30.0, camera=camera)
    inside = (np.minimum(corners.real, corners.imag) > 3).all(axis=1)
    inside &= (np.maximum(corners.real, corners.imag) < 260).all(axis=1)
    worst = match(find_quads(image), corners)[inside].max(axis=1)
    assert inside.sum() >= 8 and worst.max() < 2.5, worst


@pytest.mark.parametrize("side_px", [14, 24, 60])
def test_marker_beside_known_squares_is_found(place_markers, draw_markers, side_px):
    """15 of 16 markers are known, at the smallest distance of robots; the other marker is found.

    The known markers are mostly excluded: fewer than half of all quadrilaterals are found again.
    """
    rng = np.random.default_rng([5, side_px])
    image, corners = scene(place_markers, draw_markers, rng, side_px, step=1.6 * side_px)
    all_of_them = len(find_quads(image))
    for row in range(16):
        quads = find_quads(image, np.delete(to_points(corners), row, axis=0))
        assert match(quads, corners[[row]]).max() < 2.0
        assert len(quads) < all_of_them / 2


@pytest.mark.parametrize(("side_px", "light"), [(12, 1.0), (14, 0.5), (30, 0.4)])
def test_min_darkness_keeps_markers_in_shade(place_markers, draw_markers, side_px, light):
    """A limit of 1/40 of the contrast in full light does not change the detection of markers in shade."""
    rng = np.random.default_rng([6, side_px])
    drawn, corners = scene(place_markers, draw_markers, rng, side_px, noise=2.0)
    image = np.rint(light * drawn).astype(np.uint8)
    everyone = match(find_quads(image), corners).max(axis=1) < 2.0
    still = match(find_quads(image, None, 200 / 40), corners).max(axis=1) < 2.0
    assert everyone.mean() > 0.9
    np.testing.assert_array_equal(still, everyone)


def test_corners_run_clockwise_in_the_image(place_markers, draw_markers):
    """With v down, the cross product of consecutive sides is positive."""
    image, _ = scene(place_markers, draw_markers, np.random.default_rng(3), 25.0)
    quads = to_complex(find_quads(image))
    sides = np.roll(quads, -1, axis=1) - quads
    assert len(quads) >= 16
    assert ((sides.conj() * np.roll(sides, -1, axis=1)).imag > 0).all()
    assert (np.abs(sides) >= MIN_QUAD_SIDE_PX).all()


def test_square_without_noise_has_subpixel_corners():
    """Edges on pixel borders, blurred by the box filter only: the errors come from rounded corners."""
    image = np.full((80, 80), 220, np.uint8)
    image[20:60, 25:65] = 30
    quads = find_quads(image)
    truth = to_complex(np.array([[24.5, 19.5], [64.5, 19.5], [64.5, 59.5], [24.5, 59.5]]))
    assert match(quads, truth[None]).max() < 0.3
    # In the image of a quarter of the size, a boundary is rounded to four pixels.
    assert all(match(quad[None], truth[None]).max() < 2 * SHRINKS[-1] for quad in quads)


def test_light_squares_and_thin_bars_are_rejected():
    image = np.full((200, 200), 60, np.uint8)
    image[50:100, 50:100] = 230
    inner = find_quads(image)
    assert not any(np.abs(quad - [74.5, 74.5]).max() < 27 for quad in inner)
    image = np.full((200, 200), 220, np.uint8)
    image[50:60, 20:180] = 30  # ratio 16; MAX_SIDE_RATIO is 6
    assert not len(find_quads(image))


@pytest.mark.parametrize(("noise", "most"), [(2, 0), (10, 0), (30, 8), (60, 22)])
def test_pure_noise_gives_few_quads(noise, most):
    """Mean count a megapixel: 0 up to noise 10, 1.3 at 30, 7.6 at 60. Limits: Poisson quantiles of 1e-5."""
    rng = np.random.default_rng(noise)
    count = sum(
        len(find_quads(np.clip(rng.normal(128, noise, (500, 500)), 0, 255).astype(np.uint8)))
        for _ in range(4)
    )
    assert count <= most


@pytest.mark.parametrize(("side_px", "blur_px"), [(30, 0.6), (60, 1.2), (160, 3.0)])
def test_squares_that_touch_at_corners_are_separated(side_px, blur_px):
    """A checkerboard under a blur that joins its squares: all are found, to a tenth of a side."""
    half = side_px // 2
    image = np.full((8 * side_px, 8 * side_px), 220, np.uint8)
    truth = []
    for row in range(6):
        for column in range(row % 2, 6, 2):
            low = np.array([column, row]) * side_px + half
            image[low[1] : low[1] + side_px, low[0] : low[0] + side_px] = 30
            truth.append(to_complex(low - 0.5 + side_px * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])))
    worst = match(find_quads(cv2.GaussianBlur(image, (0, 0), blur_px)), np.array(truth)).max(axis=1)
    assert worst.max() < side_px / 10, worst


@pytest.mark.parametrize("bend_px", [0.0, 1e-14, 1e-6, 0.5])
def test_quad_with_three_collinear_corners_is_rejected(bend_px) -> None:
    """Also if rounding makes it convex: a degenerate quadrilateral has no homography for the cells."""
    corners = np.array([[0, 20, 20 + 20j, 10 + 10j + bend_px * (1j - 1)]])
    assert is_quad(corners, np.array([200.0]), 0.0).tolist() == [bend_px == 0.5]
