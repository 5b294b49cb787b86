"""What covers markers, what moves them while the image is taken, and the truth about them."""

import numpy as np
import pytest
from reference import polygon_edges_light

from skyherd.render import (
    Camera,
    CameraPose,
    Disc,
    Distortion,
    FrameTruth,
    Ground,
    Motion,
    Quad,
    Renderer,
    Sensor,
    Shot,
    Shutter,
    project_markers,
)

DICTIONARY, GROUND = "4X4_50", 128.0
WORST = 0.5
"""Grey levels: the bound of tests/render/test_exactness.py, which keeps to half of it."""

LENS = Distortion(k1=-0.25, k2=0.08, k3=-0.01, p1=0.002, p2=-0.001)
INSTANT = Shutter()


def make_renderer(shutter: Shutter = INSTANT, **sensor) -> Renderer:
    ground = Ground(0, kind="plain", mean=GROUND)
    return Renderer(
        DICTIONARY,
        1.0,
        ground,
        Sensor(rng=np.random.default_rng(0), **{"noise": 0.0, **sensor}),
        shutter=shutter,
    )


# --- what lies over markers ---


def scene() -> tuple[Camera, CameraPose, np.ndarray, np.ndarray, np.ndarray]:
    camera = Camera((200, 160), 400.0)
    return camera, CameraPose((0.0, 0.0), 10.0, 0.2), np.array([5]), np.array([[0.1, 0.0]]), np.array([0.3])


def test_a_quad_is_opaque_and_blurred_as_everything_is():
    """A rectangle of one level, against the reference's polygon, over the marker."""
    camera, pose, ids, positions, headings = scene()
    corners = np.array([[0.0, -0.4], [0.9, -0.4], [0.9, 0.5], [0.0, 0.5]])
    renderer = make_renderer()
    light = renderer.light(Shot(camera, pose, ids, positions, headings, occluders=[Quad(corners, 70.0)]))
    bare = renderer.light(Shot(camera, pose, ids, positions, headings))
    image_ground = np.linalg.inv(project_markers(camera, pose, [[0, 0]], [0.0], 1.0, 1.0).images_marker[0])
    points = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(image_ground).T
    outline = points[:, :2] / points[:, 2:]
    cover = polygon_edges_light(
        outline, np.roll(outline, -1, axis=0), np.ones(4), 0.8, np.arange(200), np.arange(160)
    )
    cover *= np.sign(cover.sum())
    np.testing.assert_allclose(light, 70.0 * cover + (1 - cover) * bare, atol=WORST)


def test_a_disc_covers_its_area():
    """Light missing over plain ground is the disc's area, to 0.1 %: that of `(σ / R)⁴ / 4` is far less."""
    camera, pose, ids, positions, headings = scene()
    light = make_renderer().light(
        Shot(camera, pose, ids[:0], positions[:0], headings[:0], occluders=[Disc((0, 0), 0.6, 28.0)])
    )
    assert (GROUND - light).sum() / 100.0 == pytest.approx(np.pi * (0.6 * 40) ** 2, rel=1e-3)
    assert light[80, 100] == pytest.approx(28.0, abs=0.01)


def test_the_visible_fraction_counts_border_and_occluders():
    """A marker with its left half off the image; one covered by a disc of a quarter of its area; one free."""
    camera, side = Camera((300, 200), 40.0, (0.0, 0.0)), 40.0
    positions = np.array([[-0.5 / side, -2.5], [3.0, -2.5], [6.0, -2.5]])
    disc = Disc((3.0, -2.5), float(np.sqrt(0.25 / np.pi)), 90.0)
    truth = project_markers(
        camera, CameraPose((0, 0), 1.0), positions, np.zeros(3), 1.0, 8 / 6, occluders=[disc]
    )
    np.testing.assert_allclose(truth.visible_fractions, [0.5, 0.75, 1.0], atol=0.002)
    assert truth.whole.tolist() == [False, False, True]


# --- truth ---


@pytest.mark.parametrize("lens", [Distortion(), LENS], ids=["no lens", "lens"])
@pytest.mark.parametrize("row_time_s", [0.0, 5e-5])
def test_truth_has_the_slopes_of_the_image(lens, row_time_s):
    """Heading, side and homography at the centre against differences of projections of marker points."""
    camera = Camera((640, 480), 400.0, distortion=lens)
    pose = CameraPose((0.3, -0.1), 10.0, 0.5, (0.2, -0.1))
    motion = Motion((2.0, -1.0, 0.5), 0.6, np.full((4, 2), 0.7), np.full(4, -2.0))
    positions, headings = (
        np.array([[0.0, 0.0], [3.0, 2.0], [-4.0, 1.0], [2.0, -3.0]]),
        np.array([0.1, 1.0, -2.0, 3.0]),
    )
    shutter = Shutter(row_time_s=row_time_s)

    def project(side: float) -> FrameTruth:
        return project_markers(
            camera, pose, positions, headings, side, side * 8 / 6, motion=motion, shutter=shutter
        )

    truth, tiny = project(0.5), project(1e-3)
    corners = tiny.corners_px
    forward = (corners[:, 0] + corners[:, 1] - corners[:, 2] - corners[:, 3]) / 2
    left = (corners[:, 0] + corners[:, 3] - corners[:, 1] - corners[:, 2]) / 2
    np.testing.assert_allclose(truth.headings_rad, np.arctan2(forward[:, 1], forward[:, 0]), atol=1e-5)
    area = np.abs(forward[:, 0] * left[:, 1] - forward[:, 1] * left[:, 0])
    np.testing.assert_allclose(truth.sides_px, 500 * np.sqrt(area), rtol=1e-5)
    np.testing.assert_allclose(truth.centers_px, corners.mean(axis=1), atol=1e-4)
    local = truth.images_marker
    np.testing.assert_allclose(local[:, :2, 2] / local[:, 2:, 2], truth.centers_px, atol=1e-9)
    mean = truth.corners_px.mean(axis=1)
    assert np.abs(mean - truth.centers_px).max() > 1e-3, "under tilt the corners' mean is not the centre"


# --- motion ---

MOVING = Motion((1.5, -0.8, 0.3), 0.4, np.array([[0.5, 0.2], [0.0, -1.0]]), np.array([1.0, -2.0]))
PAIR = np.array([3, 8]), np.array([[-0.5, 0.4], [1.0, -0.2]]), np.array([0.3, -2.0])


@pytest.mark.parametrize("lens", [Distortion(), LENS], ids=["no lens", "lens"])
def test_rolling_shutter_row_is_that_row_at_its_own_instant(lens):
    """0.5 grey levels: each of both images is right to 0.25."""
    camera, pose = Camera((160, 120), 150.0, distortion=lens), CameraPose((0.1, 0.0), 5.0, 0.3, (0.05, 0.1))
    row_time_s = 3e-4  # 36 ms from first row to last, in which the robots turn by 2 and 4 deg
    rolling = make_renderer(shutter=Shutter(row_time_s=row_time_s)).light(
        Shot(camera, pose, *PAIR, motion=MOVING)
    )
    ids, positions, headings = PAIR
    for v in range(30, 95, 8):
        t = row_time_s * (v - 59.5)
        still = make_renderer().light(
            Shot(camera, MOVING.pose_at(pose, t), ids, *MOVING.robots_at(positions, headings, t))
        )
        np.testing.assert_allclose(rolling[v], still[v], atol=WORST)
    assert np.abs(rolling - make_renderer().light(Shot(camera, pose, *PAIR))).max() > 10, "it matters"


def test_motion_blur_is_the_mean_over_the_exposure():
    """Against 60 instants in the middles of equal parts; blur of 6 px."""
    camera, pose = Camera((160, 120), 150.0), CameraPose((0.1, 0.0), 5.0, 0.3)
    exposure_s = 0.1
    blurred = make_renderer(shutter=Shutter(exposure_s)).light(Shot(camera, pose, *PAIR, motion=MOVING))
    ids, positions, headings = PAIR
    total = np.zeros((120, 160))
    for t in exposure_s * ((np.arange(60) + 0.5) / 60 - 0.5):
        total += make_renderer().light(
            Shot(camera, MOVING.pose_at(pose, t), ids, *MOVING.robots_at(positions, headings, t))
        )
    np.testing.assert_allclose(blurred, total / 60, atol=WORST)
    sharp = make_renderer().light(Shot(camera, pose, *PAIR, motion=MOVING))
    assert np.abs(blurred - sharp).max() > 10, "it matters"
    still = make_renderer(shutter=Shutter(exposure_s)).light(Shot(camera, pose, *PAIR))
    np.testing.assert_array_equal(still, sharp, "nothing moves, nothing is blurred")
