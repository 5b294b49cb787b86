"""Scenario keys of images: each changes the image, and ground truth follows."""

import cv2
import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.render import Camera, CameraPose, Motion, Shot
from skyherd.sim.perception import make_renderer

CAMERA, POSE = Camera((320, 240), 300.0), CameraPose((1.0, 0.5), 12.0, 0.2)
TEAM = (
    np.arange(4),
    np.array([[0.0, 0.0], [2.0, 1.5], [-2.0, 1.0], [3.0, -2.0]]),
    np.array([0.0, 1.0, 2.0, 3.0]),
)
MOTION = Motion((1.0, 0.5, 0.0), 0.3)

EACH = {
    "noise": ["sensor.noise=4"],
    "shot": ["sensor.shot=0.3"],
    "gain": ["sensor.gain=0.8"],
    "blur": ["sensor.psf_px=1.4"],
    "exposure": ["sensor.exposure_s=0.05"],
    "rolling shutter": ["sensor.row_time_s=1e-4"],
    "vignetting": ["sensor.vignetting=0.3"],
    "gradient": ["sensor.gradient=0.3"],
    "shadow": ["sensor.shadow=0.5"],
    "jpeg": ["sensor.jpeg_quality=40"],
    "plain": ["ground.kind=plain"],
    "tiles": ["ground.kind=tiles"],
    "clutter": ["ground.clutter_per_m2=1.0"],
}


def image(settings: list[str]) -> np.ndarray:
    mission = load_mission("star", settings)
    renderer = make_renderer(mission, np.random.default_rng(1))
    return renderer.render(Shot(CAMERA, POSE, *TEAM, motion=MOTION)).astype(float)


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return image([])


@pytest.mark.parametrize("name", EACH)
def test_each_key_changes_the_image(name, plain):
    assert np.abs(image(EACH[name]) - plain).mean() > 0.3


def test_defaults_change_nothing(plain):
    off = [
        f"sensor.{key}=0" for key in ("shot", "exposure_s", "row_time_s", "vignetting", "gradient", "shadow")
    ]
    np.testing.assert_array_equal(image([*off, "sensor.gain=1", "ground.clutter_per_m2=0"]), plain)


def test_a_run_with_everything_on(tmp_path):
    """Ground truth follows lens and shutter: detections are within half a side of it.

    Covered robots do not count as wholly in view.
    """
    picture = np.random.default_rng(2).integers(90, 160, (60, 90), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "floor.png"), picture)
    lens = "{ k1 = -0.1, p1 = 0.001 }"
    mission = load_mission(
        "star",
        [
            "duration_s=0.1",
            *[f"units.{unit}.camera.distortion={lens}" for unit in range(3)],
            "sensor.shot=0.05",
            "sensor.exposure_s=0.01",
            "sensor.row_time_s=2e-5",
            "sensor.vignetting=0.2",
            "sensor.shadow=0.2",
            "sensor.jpeg_quality=90",
            "ground.kind=image",
            f"ground.image={tmp_path / 'floor.png'}",
            "ground.clutter_per_m2=0.05",
            "occluders=[{ center_m = [-9.403, 2.898], radius_m = 0.5 }]",
        ],
    )
    sights = [frame.sight for step in run_steps(mission) for frame in step.frames.values()]
    assert len(sights) == 6
    assert sum(sight.false_detections for sight in sights) == 0
    found, whole = (
        sum(len(ids) for ids in parts)
        for parts in zip(*((s.found_ids, s.whole_ids) for s in sights), strict=True)
    )
    assert found > 0.9 * whole
    assert not any(0 in sight.whole_ids for sight in sights)
