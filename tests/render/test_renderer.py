"""Cameras in their frames, and the renderer as a whole; tests/render/test_exactness.py has the pixels."""

import cv2
import numpy as np
import pytest

from skyherd.markers.dictionary import card_side
from skyherd.render import (
    Camera,
    CameraPose,
    Ground,
    Renderer,
    Sensor,
    Shot,
    homography_image_ground,
    project,
    project_markers,
)
from skyherd.render.camera.camera import footprint_m

DICTIONARY, PSF_PX = "4X4_50", 0.8
BLACK, WHITE, GROUND = 30.0, 230.0, 128.0
IMAGE_PX = 120


def cells_of(marker_id: int) -> np.ndarray:
    """Grey levels (8, 8) of marker and card, from OpenCV's own drawing."""
    marker = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), marker_id, 60
    )
    levels = np.where(marker[5::10, 5::10] > 127, WHITE, BLACK)
    return np.pad(levels, 1, constant_values=WHITE)


def flat_renderer(noise: float = 0.0, seed: int = 0) -> Renderer:
    return Renderer(DICTIONARY, 1.0, FLAT, Sensor(noise, np.random.default_rng(seed)), psf_px=PSF_PX)


FLAT = Ground(0, mean=GROUND, contrast=0.0)


# --- cameras: the frames of ARCHITECTURE.md ---


@pytest.mark.smoke
def test_the_image_is_what_one_sees_looking_down() -> None:
    """At yaw 0 +u is east (+x), +v is south (-y): north is up in the image, and it is not mirrored."""
    camera = Camera((640, 480), focal_px=500.0)
    pose = CameraPose((2.0, 3.0), 10.0)
    here, east, south = project(camera, pose, [[2, 3], [3, 3], [2, 2]])
    np.testing.assert_allclose(here, [319.5, 239.5], atol=1e-12)  # an integer is a pixel's centre
    np.testing.assert_allclose(east - here, [50, 0], atol=1e-12)
    np.testing.assert_allclose(south - here, [0, 50], atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 2.0, -3.0])
def test_plus_u_lies_at_yaw_on_the_ground(yaw) -> None:
    """p = c + (f / h) conj((x - x_camera) e^{-i yaw}), by definition, at any zoom and principal point."""
    rng = np.random.default_rng(5)
    camera = Camera((640, 480), focal_px=321.0, principal_point_px=(300.25, 251.5))
    pose = CameraPose((-1.5, 4.0), 7.0, yaw, zoom=1.7)
    points = rng.uniform(-5, 5, (20, 2))
    image = project(camera, pose, points)
    ground = points[:, 0] + 1j * points[:, 1] - (-1.5 + 4j)
    expected = 300.25 + 251.5j + 321.0 * 1.7 / 7.0 * np.conj(ground * np.exp(-1j * yaw))
    np.testing.assert_allclose(image[:, 0] + 1j * image[:, 1], expected, rtol=0, atol=1e-10)


def test_only_a_mirrored_camera_turns_the_scene_over() -> None:
    """Ground to image reverses orientation in numbers (v is down), mirrored it does not; a flip undoes it."""
    pose = CameraPose((0.0, 0.0), 5.0, 0.3)
    plain, mirrored = Camera((100, 80), 90.0), Camera((100, 80), 90.0, mirrored=True)
    assert np.linalg.det(homography_image_ground(plain, pose)[:2, :2]) < 0
    assert np.linalg.det(homography_image_ground(mirrored, pose)[:2, :2]) > 0
    points = np.random.default_rng(6).uniform(-2, 2, (9, 2))
    there, here = project(mirrored, pose, points), project(plain, pose, points)
    np.testing.assert_allclose(there, here * [-1, 1] + [99, 0], atol=1e-12)


def test_a_mirrored_camera_renders_the_flipped_image() -> None:
    ids, positions, headings = np.array([3, 8]), np.array([[-0.5, 0.4], [1.0, -0.2]]), np.array([0.3, -2.0])
    pose = CameraPose((0.1, 0.0), 5.0, 0.3)
    image, flipped = (
        flat_renderer()
        .render(Shot(Camera((300, 240), 250.0, mirrored=m), pose, ids, positions, headings))
        .astype(float)
        for m in (False, True)
    )
    assert np.abs(flipped[:, ::-1] - image).max() <= 1, "but for rounding to 8 bits"
    assert image.std() > 10


def test_aspect_stretches_v_alone() -> None:
    pose = CameraPose((0.0, 0.0), 5.0, 0.3)
    points = np.random.default_rng(6).uniform(-2, 2, (9, 2))
    center = np.array([49.5, 39.5])
    square = project(Camera((100, 80), 90.0), pose, points) - center
    wide = project(Camera((100, 80), 90.0, aspect=1.25), pose, points) - center
    np.testing.assert_allclose(wide, square * [1, 1.25], rtol=0, atol=1e-12)


def test_footprint_is_what_projects_to_the_images_border() -> None:
    camera = Camera((640, 480), 500.0, (300.0, 260.0))
    pose = CameraPose((2.0, 3.0), 10.0, 0.7, (0.1, -0.05), 1.2)
    corners = project(camera, pose, footprint_m(camera, pose))
    expected = [[-0.5, -0.5], [639.5, -0.5], [639.5, 479.5], [-0.5, 479.5]]
    np.testing.assert_allclose(corners, expected, rtol=0, atol=1e-9)


@pytest.mark.smoke
def test_the_marker_faces_where_the_robot_does() -> None:
    """Robot at heading +90 deg (north) under a camera at yaw 0: its pattern stands upright in the image."""
    camera = Camera((IMAGE_PX, IMAGE_PX), 60.0)
    image = flat_renderer().render(
        Shot(camera, CameraPose((0, 0), 1.0), np.array([11]), np.zeros((1, 2)), np.array([np.pi / 2]))
    )
    middle = (IMAGE_PX - 1) / 2 + 10 * (np.arange(8) - 3.5)
    rows, columns = np.meshgrid(np.rint(middle).astype(int), np.rint(middle).astype(int), indexing="ij")
    np.testing.assert_allclose(image[rows, columns], cells_of(11), atol=1)


def test_the_quiet_zone_is_white_all_round() -> None:
    """A ring of one cell, 10 px wide here: its middle, 5 px outside the black square, is white."""
    camera = Camera((IMAGE_PX, IMAGE_PX), 60.0)
    image = flat_renderer().render(
        Shot(camera, CameraPose((0, 0), 1.0), np.array([11]), np.zeros((1, 2)), np.array([0.0]))
    )
    middle, out = (IMAGE_PX - 1) / 2, 35
    along = np.arange(-30, 31) + middle
    low, high = int(middle - out), int(np.ceil(middle + out))
    for ring in (image[low, :], image[high, :], image[:, low], image[:, high]):
        np.testing.assert_array_equal(ring[np.rint(along).astype(int)], WHITE)


@pytest.mark.parametrize(("offset", "whole"), [(-0.01, False), (0.01, True)])
def test_a_marker_is_whole_when_its_card_is(offset, whole) -> None:
    """The card's edge on the image's border, -0.5 px: a hundredth of a pixel further in, and it is whole."""
    side = 30.0
    camera = Camera((200, 200), side, (0.0, 0.0))
    at = np.array([[-0.5 + side * (8 / 6) / 2 + offset, -100.0]]) / side
    seen = project_markers(camera, CameraPose((0, 0), 1.0), at, np.array([0.0]), 1.0, card_side(DICTIONARY))
    assert seen.whole.tolist() == [whole]


def test_tilt_is_a_turn_about_the_cameras_own_axes() -> None:
    """Straight down lies at v = -f tan(tilt_u), u = +f tan(tilt_v): the scene turns with the sign of tilt."""
    camera = Camera((640, 480), 500.0, (0.0, 0.0))
    for yaw in (0.0, 1.0):
        about_u = project(camera, CameraPose((2.0, 3.0), 10.0, yaw, (0.1, 0.0)), [2.0, 3.0])
        about_v = project(camera, CameraPose((2.0, 3.0), 10.0, yaw, (0.0, 0.1)), [2.0, 3.0])
        np.testing.assert_allclose(about_u, [0, -500 * np.tan(0.1)], atol=1e-9)
        np.testing.assert_allclose(about_v, [500 * np.tan(0.1), 0], atol=1e-9)


def scene(seed: int, ground: Ground) -> np.ndarray:
    renderer = Renderer(DICTIONARY, 1.0, ground, Sensor(2.0, np.random.default_rng(seed)))
    camera, pose = Camera((320, 240), 200.0), CameraPose((1.0, 2.0), 8.0, 0.4)
    return renderer.render(
        Shot(camera, pose, np.array([1, 2]), np.array([[1.0, 2.0], [3.0, 2.5]]), np.array([0.0, 1.0]))
    )


def test_pixels_come_from_the_seeds() -> None:
    one, again, other = Ground(1), Ground(1), Ground(2)
    np.testing.assert_array_equal(scene(1, one), scene(1, again))
    assert not np.array_equal(scene(1, one), scene(2, one)), "the sensor's seed"
    assert not np.array_equal(scene(1, one), scene(1, other)), "the ground's seed"


def test_camera_turned_from_the_origin_sees_what_is_before_it() -> None:
    """Tilted by 60 deg, with the ground's origin behind it: the same image as with the whole world moved."""
    camera, tilt = Camera((120, 120), 300.0), (np.radians(60.0), 0.0)
    ahead = np.array([[0.0, -10.0 * np.tan(tilt[0])]])
    images = []
    for away in (np.array([0.0, -30.0]), np.array([0.0, 40.0])):
        pose = CameraPose((float(away[0]), float(away[1])), 10.0, tilt_rad=tilt)
        team = np.array([3]), ahead + away, np.array([0.5])
        assert project(camera, pose, team[1])[0] == pytest.approx([59.5, 59.5], abs=1e-9)
        images.append(flat_renderer().render(Shot(camera, pose, *team)))
    assert images[0].max() > 200 and images[0].min() < 100
    np.testing.assert_array_equal(*images)
