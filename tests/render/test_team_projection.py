"""Projection of a team into many cameras, against one camera at a time."""

import numpy as np
import pytest

from skyherd.render import Camera, CameraPose, Distortion, TeamImage, project_markers, project_team
from skyherd.render import team_projection as team_module

SIDE_M, CARD_M = 0.4, 0.6
LENS = Distortion(k1=-0.25, k2=0.08, k3=-0.01, p1=0.002, p2=-0.001)


def draw_view(rng: np.random.Generator, tilt_rad: float, lens: Distortion) -> tuple[Camera, CameraPose]:
    """Return a random camera and pose, with aspect, skew, principal point, mirroring and zoom."""
    width, height = rng.integers(200, 900, 2)
    camera = Camera(
        (int(width), int(height)),
        float(rng.uniform(500, 900)),
        principal_point_px=(float(width * rng.uniform(0.4, 0.6)), float(height * rng.uniform(0.4, 0.6))),
        aspect=float(rng.uniform(0.8, 1.2)),
        skew=float(rng.uniform(-0.1, 0.1)),
        mirrored=bool(rng.random() < 0.2),
        distortion=lens,
    )
    turn = np.exp(2j * np.pi * rng.random()) * tilt_rad
    pose = CameraPose(
        (float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20))),
        float(rng.uniform(4, 20)),
        float(rng.uniform(-3, 3)),
        (float(turn.real), float(turn.imag)),
        float(rng.uniform(0.7, 1.5)),
    )
    return camera, pose


def draw_team(rng: np.random.Generator, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(-30, 30, (count, 2)), rng.uniform(-np.pi, np.pi, count)


@pytest.mark.parametrize("lens", [Distortion(), LENS], ids=["pinhole", "lens"])
@pytest.mark.parametrize("tilt_rad", [0.0, 0.3, 1.3], ids=["straight down", "tilted", "horizon in view"])
@pytest.mark.parametrize("seed", range(4))
def test_team_projection_matches_project_markers(seed, tilt_rad, lens) -> None:
    """The culled markers are out of view, and the others have equal points up to rounding.

    On some processors, sums over arrays of other lengths differ in the last bit: 1e-13 of 1e3 px.
    """
    rng = np.random.default_rng(seed)
    views = [draw_view(rng, tilt_rad, lens) for _ in range(8)]
    positions, headings = draw_team(rng)
    seen = 0
    images = list(project_team(views, positions, headings, SIDE_M, CARD_M))
    for (camera, pose), image in zip(views, images, strict=True):
        truth = project_markers(camera, pose, positions, headings, SIDE_M, CARD_M)
        np.testing.assert_array_equal(image.rows, np.flatnonzero(truth.whole))
        np.testing.assert_allclose(image.centers_px, truth.centers_px[truth.whole], rtol=0, atol=1e-10)
        np.testing.assert_allclose(image.corners_px, truth.corners_px[truth.whole], rtol=0, atol=1e-10)
        seen += image.rows.size
    assert seen > 20, "the comparison is of something"


def test_only_markers_near_a_footprint_are_projected() -> None:
    """Few robots of a team spread over 60 m are near a footprint of about 8 m."""
    rng = np.random.default_rng(1)
    views = [draw_view(rng, 0.0, Distortion()) for _ in range(8)]
    positions, _ = draw_team(rng)
    matrices = np.array([team_module.homography_image_ground(*view) for view in views])
    assert 0 < team_module._near(views, matrices, positions).mean() < 0.2


def test_projection_without_cameras_or_robots_is_empty() -> None:
    assert list(project_team([], *draw_team(np.random.default_rng(0)), SIDE_M, CARD_M)) == []
    (image,) = project_team(
        [(Camera((100, 100), 100.0), CameraPose((0, 0), 5.0))], np.zeros((0, 2)), np.zeros(0), SIDE_M, CARD_M
    )
    assert isinstance(image, TeamImage) and image.rows.size == 0
