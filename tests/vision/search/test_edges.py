"""Corners from gradients along the sides of dark quadrilaterals, and faint quadrilaterals."""

import cv2
import numpy as np
import pytest
from edge_reference import reference_edges
from native_builds import builds

from skyherd.errors import InputError
from skyherd.vision.native.library import declared, library
from skyherd.vision.search.edges import edge_parameters, fit_edges
from skyherd.vision.search.faint import (
    COARSE_SPREAD,
    FINE_SPREAD,
    find_faint_quads,
    stretched_contrasts,
)
from skyherd.vision.search.quads import find_quads

QUAD = np.array([[30.3, 28.1], [92.7, 35.4], [88.2, 97.9], [25.6, 90.2]])
FINE = 8


def drawn(quad: np.ndarray, *, black: float = 40.0, white: float = 200.0, blur_px: float = 0.8) -> np.ndarray:
    """An exact image of a dark quadrilateral, by means over 8 x 8 points of each pixel, then blurred."""
    mask = np.zeros((128 * FINE, 128 * FINE), dtype=np.uint8)
    points = np.rint(((quad + 0.5) * FINE - 0.5) * 256).astype(np.int32)
    cv2.fillConvexPoly(mask, points, 255, cv2.LINE_8, 8)
    share = cv2.resize(mask, (128, 128), interpolation=cv2.INTER_AREA) / 255.0
    return cv2.GaussianBlur(white + (black - white) * share, (0, 0), blur_px)


def noisy(levels: np.ndarray, seed: int, std: float = 2.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(levels + rng.normal(0, std, levels.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("seed", range(4))
def test_corners_are_found_from_a_pixel_away(seed) -> None:
    """To 0.15 px: points of a side are 0.1 px off, and the square is drawn 0.06 px too large."""
    start = QUAD + np.random.default_rng(seed).uniform(-1, 1, QUAD.shape)
    fitted = fit_edges(noisy(drawn(QUAD), seed), start[None], 6)
    assert np.abs(fitted.corners_px[0] - QUAD).max() < 0.15 < np.abs(start - QUAD).max()


def test_cover_over_a_part_of_a_side_has_no_influence() -> None:
    """A third of one side under a grey disc; fitted without weights, the negative control, it moves."""
    levels = drawn(QUAD)
    cv2.circle(levels, (60, 32), 10, 120.0, cv2.FILLED)
    fitted = fit_edges(noisy(levels, 1), QUAD[None] + 0.5, 6)
    assert np.abs(fitted.corners_px[0] - QUAD).max() < 0.2
    assert fitted.supports[0] < 1.0


def test_order_of_corners_is_kept_from_any_first_corner() -> None:
    image = noisy(drawn(QUAD), 2)
    turned = [fit_edges(image, np.roll(QUAD, -k, axis=0)[None], 6).corners_px[0] for k in range(4)]
    for k in range(1, 4):
        np.testing.assert_allclose(np.roll(turned[k], k, axis=0), turned[0], atol=1e-6)


def test_no_quadrilateral_gives_no_corners() -> None:
    assert fit_edges(noisy(drawn(QUAD), 3), np.zeros((0, 4, 2)), 6).corners_px.shape == (0, 4, 2)


def scattered_squares(seed: int, count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """An image of squares, parts of them covered, with noise, and corners up to 1.5 px off."""
    rng = np.random.default_rng(seed)
    levels, quads = np.full((480, 640), 190.0), []
    for k in range(count):
        size, turn = rng.uniform(8, 50), rng.uniform(0, 2 * np.pi)
        middle = np.array([64.0 * (k % 10) + 32, 80 * (k // 10) + 40])
        arms = size / np.sqrt(2) * np.exp(1j * (turn + np.pi / 2 * np.arange(4)))
        quads.append(middle + np.column_stack([arms.real, arms.imag]) * rng.uniform(0.6, 1.0, 2))
        cv2.fillConvexPoly(levels, np.rint(quads[-1] * 256).astype(np.int32), 50.0, cv2.LINE_AA, 8)
        if k % 3 == 0:
            cv2.circle(levels, np.rint(quads[-1][0]).astype(int).tolist(), 4, 150.0, cv2.FILLED)
    started = np.array(quads) + rng.uniform(-1.5, 1.5, (count, 4, 2))
    return noisy(cv2.GaussianBlur(levels, (0, 0), 0.9), seed), started


@pytest.mark.parametrize("seed", range(3))
def test_compiled_edges_agree_with_numpy(seed) -> None:
    """To single precision of the grey levels, wherever no point is at the limit of an inlier."""
    image, quads = scattered_squares(seed)
    corners, spreads, supports, rises = library().refined_corners(image, quads, 6, edge_parameters())
    expected = reference_edges(image, quads, 6)
    alike = supports == expected[2]
    assert alike.mean() > 0.9 and 0.3 < supports.min() < 0.9 < supports.max()
    np.testing.assert_allclose(corners[alike], expected[0][alike], atol=2e-4)
    np.testing.assert_allclose(spreads[alike], expected[1][alike], atol=1e-4)
    np.testing.assert_allclose(rises, expected[3], atol=1e-2)


def test_corners_between_parallel_sides_stay() -> None:
    """Two corners lie on the line through their neighbours, so that adjacent sides meet nowhere."""
    flat = np.array([[20.0, 30], [50, 30], [80, 30], [80, 60]])
    corners, *_ = library().refined_corners(
        np.full((90, 110), 100, np.uint8), flat[None], 6, edge_parameters()
    )
    np.testing.assert_allclose(corners[0], flat, atol=1e-9)


def test_edges_have_equal_bytes_in_all_builds() -> None:
    image, quads = scattered_squares(5)
    found = [
        other.refined_corners(image, quads, 8, edge_parameters())
        for other in builds("vision", declared).values()
    ]
    assert len({b"".join(part.tobytes() for part in one) for one in found}) == 1


@pytest.mark.parametrize("name", ["normals", "steps", "rounds", "reweightings"])
@pytest.mark.parametrize("value", [0, -1, 65])
def test_numbers_that_edges_have_no_room_for_are_rejected(name, value) -> None:
    parameters = type(edge_parameters()).from_buffer_copy(edge_parameters())
    setattr(parameters, name, value)
    with pytest.raises(InputError):
        library().refined_corners(np.zeros((9, 9), np.uint8), QUAD[None], 6, parameters)


def test_corners_of_other_types_and_shapes_are_rejected() -> None:
    image = np.zeros((9, 9), np.uint8)
    for wrong in (QUAD[None].astype(np.float32), QUAD, np.zeros((1, 8, 2))[:, ::2]):
        with pytest.raises(InputError):
            library().refined_corners(image, wrong, 6, edge_parameters())
    with pytest.raises(InputError):
        library().refined_corners(image, QUAD[None], 0, edge_parameters())


@pytest.mark.parametrize(("contrast", "noise"), [(4.5, 0.5), (9.0, 1.0), (9.0, 2.0)])
def test_faint_square_is_found_when_stretched(contrast, noise) -> None:
    """The search itself, the negative control, misses it."""
    image = noisy(drawn(QUAD, black=100.0, white=100.0 + contrast), 4, noise)

    def finds(quads: np.ndarray) -> bool:
        return bool((np.abs(quads.mean(axis=1) - QUAD.mean(axis=0)).max(axis=1) < 2).any())

    assert finds(find_faint_quads(image, np.zeros((0, 4, 2)), noise)) and not finds(find_quads(image))


def test_faint_images_are_stretched_to_one_contrast() -> None:
    """Of 2.5 to 4.5 grey levels, eight times the noise and more; of 40 the fine image is flat."""
    stretched = []
    for contrast in (2.5, 3.5, 4.5):
        levels = contrast / 40 * texture()
        rounded = np.rint(120 + levels + np.random.default_rng(6).uniform(-0.5, 0.5, levels.shape))
        stretched.append(stretched_contrasts(rounded.astype(np.uint8), 0.3))
    for images, spread in zip(zip(*stretched, strict=True), (FINE_SPREAD, COARSE_SPREAD), strict=True):
        for one in images:
            assert one.std() == pytest.approx(spread, rel=0.15)
            assert np.corrcoef(one.ravel(), images[-1].ravel())[0, 1] > 0.9
    fine, coarse = stretched_contrasts(np.rint(120 + texture()).astype(np.uint8), 0.3)
    assert np.unique(fine).tolist() == [128] and np.isin(coarse, [0, 255]).mean() > 0.3


def test_faint_square_on_texture_is_found_when_stretched() -> None:
    """On texture of a ninth of the contrast, which fills the image as the square's own edges do."""
    grain = cv2.GaussianBlur(np.random.default_rng(8).normal(size=(128, 128)), (0, 0), 1.0)
    image = noisy(drawn(QUAD, black=100.0, white=118.0) + 2.0 * grain / grain.std(), 9, 0.5)
    middles = find_faint_quads(image, np.zeros((0, 4, 2)), 0.5).mean(axis=1)
    assert (np.abs(middles - QUAD.mean(axis=0)).max(axis=1) < 2).any()


def texture() -> np.ndarray:
    """Smooth noise of 128 x 128 px with a standard deviation of 40 grey levels, within 120 of zero."""
    noise = cv2.GaussianBlur(np.random.default_rng(7).normal(size=(128, 128)), (0, 0), 4.0)
    return np.clip(40 * noise / noise.std(), -119, 119)
