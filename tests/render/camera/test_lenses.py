"""Lenses: fisheye, lens field, zoom lenses and presets, with images against the exact reference."""

import cv2
import numpy as np
import pytest
from reference import reference_light

from skyherd.datasets import load_mission, make_mission
from skyherd.datasets.configuration.camera_models import CameraModel, UnitCameraModel
from skyherd.datasets.configuration.cameras import CAMERAS
from skyherd.datasets.configuration.unit_models import UnitModel
from skyherd.errors import InputError
from skyherd.geometry import inverse
from skyherd.render import (
    Camera,
    CameraPose,
    Distortion,
    Equidistant,
    Ground,
    Renderer,
    Sensor,
    Shot,
    project,
    project_markers,
)
from skyherd.render.camera.camera import lens_field, lens_jacobians, undistort
from skyherd.sim.perception import make_perception
from skyherd.sim.physics import make_world

FISHEYE = Camera((800, 600), 300 / np.radians(45), (406.0, 291.0), distortion=Equidistant())
"""Fisheye with a field of view of 120 degrees across the longer side."""


def test_fisheye_radius_is_proportional_to_the_angle():
    """The angles reach 80 degrees in all directions, where the rounding of tan is 1e-14."""
    rng = np.random.default_rng(1)
    angle, way = np.radians(np.r_[0.0, 1e-6, rng.uniform(0, 80, 200)]), rng.uniform(-np.pi, np.pi, 202)
    direction = np.column_stack([np.cos(way), np.sin(way)])
    rays = np.tan(angle)[:, None] * direction
    seen = Equidistant().apply(rays)
    np.testing.assert_allclose(seen, angle[:, None] * direction, rtol=0, atol=1e-14)
    np.testing.assert_allclose(Equidistant().remove(seen), rays, rtol=1e-12, atol=1e-14)


def test_fisheye_jacobian_matches_differences():
    """Central differences of 1e-6 have a rounding error of 1e-10, and a smaller truncation error."""
    rays = np.random.default_rng(2).uniform(-2, 2, (100, 2))
    rays[0], rays[1] = 0.0, [1e-5, -3e-5]
    step = 1e-6
    found = np.stack(
        [
            (Equidistant().apply(rays + d) - Equidistant().apply(rays - d)) / (2 * step)
            for d in step * np.eye(2)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(Equidistant().jacobian(rays), found, rtol=0, atol=1e-9)


def test_fisheye_projection_matches_opencv():
    """`cv2.fisheye` without coefficients is the equidistant projection."""
    rng, pose = np.random.default_rng(3), CameraPose((0.3, -0.2), 6.0, 0.7, (0.1, -0.15))
    points = rng.uniform(-8, 8, (60, 2))
    straight = project(Camera(FISHEYE.size_px, FISHEYE.focal_px, FISHEYE.principal_point_px), pose, points)
    rays = np.column_stack([straight, np.ones(60)]) @ inverse(FISHEYE.intrinsic_matrix()).T
    theirs = cv2.fisheye.projectPoints(
        rays[:, None], np.zeros(3), np.zeros(3), FISHEYE.intrinsic_matrix(), np.zeros(4)
    )[0][:, 0]
    np.testing.assert_allclose(project(FISHEYE, pose, points), theirs, atol=1e-9)


def test_fisheye_image_matches_the_reference():
    """The markers are up to 65 degrees off the axis, with 16 to 47 px. OpenCV distorts the reference's edges.

    The bounds are those of tests/render/test_exactness.py: 0.5 grey levels at most, and 0.1 RMS. Beyond 60
    degrees the scale changes by 1 % per pixel, and the bound is twice as large.
    """
    rng, pose = np.random.default_rng(4), CameraPose((0.0, 0.0), 8.0, 0.4, (0.1, -0.05))
    grid = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-3, 4)), axis=-1).reshape(-1, 2)[:50]
    positions, headings = grid * 3.2 + rng.uniform(-0.2, 0.2, grid.shape), rng.uniform(-3, 3, len(grid))
    ids, matrix = np.arange(len(grid)), FISHEYE.intrinsic_matrix()
    straight = Camera(FISHEYE.size_px, FISHEYE.focal_px, FISHEYE.principal_point_px)
    images = project_markers(straight, pose, positions, headings, 1.0, 8 / 6).images_marker

    def bend(points: np.ndarray) -> np.ndarray:
        rays = np.column_stack([points, np.ones(len(points))]) @ np.linalg.inv(matrix).T
        none = np.zeros(3)
        return cv2.fisheye.projectPoints(rays[:, None], none, none, matrix, np.zeros(4))[0][:, 0]

    exact = reference_light("4X4_50", ids, images, FISHEYE.size_px, psf_px=0.8, bend=bend)
    sensor = Sensor(0.0, np.random.default_rng(0))
    renderer = Renderer("4X4_50", 1.0, Ground(0, kind="plain"), sensor)
    difference = renderer.light(Shot(FISHEYE, pose, ids, positions, headings)) - exact
    v, u = np.mgrid[: FISHEYE.size_px[1], : FISHEYE.size_px[0]]
    angle_deg = np.degrees(np.hypot(u - 406.0, v - 291.0) / FISHEYE.focal_px)
    assert np.abs(difference[angle_deg < 60]).max() < 0.5
    assert np.abs(difference).max() < 1.0
    assert np.sqrt((difference[np.abs(exact - 128) > 0.01] ** 2).mean()) < 0.1
    truth = renderer.truth(Shot(FISHEYE, pose, ids, positions, headings))
    off_axis = np.degrees(np.linalg.norm(truth.centers_px - FISHEYE.principal_point_px, axis=1))
    touched = truth.visible_fractions > 0.5
    assert (off_axis[touched] / FISHEYE.focal_px).max() > 60, "the test goes far out"


def test_lens_field_matches_the_lens_at_every_pixel():
    """The error of the splines is below 2e-4 px, and below 1e-3 px for a lens that almost folds."""
    lenses = [
        (Camera((480, 360), 400.0, distortion=Distortion(k1=-0.2, k2=0.05, p1=0.002)), 2e-4),
        (FISHEYE, 2e-4),
        (Camera((480, 480), 497.0, distortion=Distortion(k1=-0.3)), 1e-3),
        (Camera((96, 64), 100.0, distortion=Distortion(k1=-0.2)), 2e-4),
    ]
    for camera, most in lenses:
        field, (width, height) = lens_field(camera, 1.0), camera.size_px
        v, u = np.mgrid[:height, :width].astype(float)
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        straight = undistort(camera, 1.0, pixels)
        slopes = lens_jacobians(camera, 1.0, straight)
        off = field.fields[:2].T - (straight - pixels)
        assert np.abs(np.einsum("nij,nj->ni", slopes, off)).max() < most
        product = np.stack(field.fields[2:], axis=-1).reshape(-1, 2, 2) @ slopes
        assert np.abs(product - np.eye(2)).max() < 10 * most


def test_zoom_lens_changes_k1_with_the_zoom():
    """At zoom z the lens equals one with k1 + zoom_k1 log2 z and z times the focal length."""
    points = np.random.default_rng(5).uniform(-2, 2, (40, 2))
    lens = Camera((800, 800), 700.0, distortion=Distortion(k1=-0.2, zoom_k1=0.4))
    for zoom, k1 in ((1.0, -0.2), (2.0, 0.2), (2**0.5, 0.0), (1.2, -0.2 + 0.4 * np.log2(1.2))):
        pose = CameraPose((0.0, 0.0), 10.0, 0.2, (0.05, 0.0), zoom)
        plain = Camera((800, 800), 700.0 * zoom, distortion=Distortion(k1=k1))
        at_one = CameraPose((0.0, 0.0), 10.0, 0.2, (0.05, 0.0))
        np.testing.assert_allclose(project(lens, pose, points), project(plain, at_one, points), atol=1e-9)
    model = CameraModel(half_angle_deg=30.0, distortion={"k1": -0.2}, zoom_k1=0.4)
    assert model.make(2.0).distortion == Distortion(k1=pytest.approx(0.2))
    assert bool(Distortion(zoom_k1=0.1))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"lens": "equidistant", "half_angle_deg": 62.0}, ["camera.lens", "degrees off the axis", "83"]),
        ({"lens": "equidistant", "half_angle_deg": 40.0, "zoom_k1": 0.1}, ["zoom_k1", "perspective"]),
        (
            {"lens": "equidistant", "half_angle_deg": 40.0, "distortion": {"k1": 0.1}},
            ["distortion", "leave it out"],
        ),
        ({"preset": "fish"}, ["no preset 'fish'", "fisheye"]),
        (
            {"preset": "phone", "focal_px": 500.0, "half_angle_deg": 20.0},
            ["focal_px and half_angle_deg", "exactly one"],
        ),
        (
            {"half_angle_deg": 30.0, "distortion": {"k1": -0.2}, "zoom_k1": 0.5},
            ["camera.distortion", "folds"],
        ),
    ],
)
def test_invalid_lens_is_refused_in_one_line(changes, said):
    unit = f"{{ position_m = [0, 0], height_m = 9, camera = {toml(changes)}, zoom = [[0, 1], [5, 0.5]] }}"
    with pytest.raises(InputError) as refused:
        load_mission("triangle", [f"units=[{unit}]"])
    line = str(refused.value)
    assert "\n" not in line
    for words in said:
        assert words in line


def toml(table: dict) -> str:
    """Return a TOML inline table."""
    parts = (
        f"{key} = {toml(value) if isinstance(value, dict) else repr(value)}" for key, value in table.items()
    )
    return "{ " + ", ".join(parts) + " }"


def test_fisheye_refuses_rays_far_off_its_axis():
    with pytest.raises(InputError, match="86 degrees off the axis"):
        Camera((800, 800), 400 * 2**0.5 / 1.5, distortion=Equidistant())
    with pytest.raises(InputError, match="lens"):
        Equidistant().remove(np.array([[1.5, 0.0]]))


# --- test cameras by name ---


def test_other_keys_override_a_preset():
    camera = CameraModel(preset="phone", aspect=1.1, focal_px=900.0)
    assert (camera.size_px, camera.aspect, camera.focal_length_px) == ((800, 600), 1.1, 900.0)
    assert camera.distortion.k1 == CAMERAS["phone"]["distortion"]["k1"]
    again = CameraModel.model_validate(camera.model_dump(mode="json"))
    assert again == camera, "a recording's own copy is the same camera"


def test_fisheye_preset_has_120_degrees():
    """The middle of the right border is 60 degrees off the axis."""
    camera = CameraModel(preset="fisheye").make()
    middle = undistort(camera, 1.0, np.array([[799.5, 299.5]]))[0]
    assert np.arctan((middle[0] - 399.5) / camera.focal_px) == pytest.approx(np.radians(60))


@pytest.mark.parametrize("name", CAMERAS)
def test_markers_are_found_with_every_preset_camera(name, scenario_tree):
    """One image contains all six robots, with markers of at least 14 px."""
    tree = scenario_tree("triangle")
    camera = UnitCameraModel(preset=name)
    reach_m = 0.4 * min(camera.size_px) / camera.focal_length_px * 12.0
    tree["robots"] = {"scatter": {"scale_m": 0.5 * reach_m, "jitter_m": 0.1, "spacing_m": 0.8}}
    tree["units"] = [UnitModel(position_m=(0, 0), height_m=12.0, camera=camera).model_dump()]
    tree["marker"]["side_m"] = max(0.4, 20 / camera.focal_length_px * 12.0)
    mission = make_mission(tree)
    sight = make_perception(mission, np.random.default_rng(1)).look(make_world(mission), [0], 0.0)[0]
    assert sight.whole_ids.size == 6
    np.testing.assert_array_equal(np.sort(sight.found_ids), np.arange(6))
    assert sight.detections.sides_px.min() > 14
    assert sight.false_detections == 0


def load_mission_tree(tree: dict):
    from skyherd.datasets import make_mission

    return make_mission(tree)
