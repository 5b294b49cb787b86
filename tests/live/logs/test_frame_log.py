"""Previews of a unit's images: content, rate, and no blocking."""

import base64
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from live_sessions import small_lab
from plain_messages import assert_valid, plain
from scipy.spatial.transform import Rotation

from skyherd.geometry import to_points
from skyherd.live.logs import frame_log
from skyherd.live.logs.frame_log import Sight
from skyherd.live.logs.marker_poses import PoseMeter
from skyherd.live.logs.view import view_of
from skyherd.messages import Detections
from skyherd.poses import Calibration
from skyherd.poses.marker_poses import pose_difference
from skyherd.render import Camera, CameraPose, Ground, Renderer, Sensor, Shot
from skyherd.render.camera.camera import rotation_camera_world
from skyherd.vision import create_detector

PATIENCE_S = 30.0


@pytest.fixture(scope="module")
def lab():
    return small_lab(robots=4)


@pytest.fixture(scope="module")
def seen(lab):
    """Return detections of four robots near their shape, and of another marker twice."""
    points = 320 + 240j + 60 * lab.template.points_px + np.array([3, -2j, 1 + 1j, 0])
    points = np.append(points, [50 + 50j, 600 + 50j])
    corners = np.array([-10 - 10j, 10 - 10j, 10 + 10j, -10 + 10j])
    return Detections(
        unit_id=0,
        time_s=100.0,
        image_size_px=np.array([640, 480]),
        ids=np.array([3, 0, 2, 1, 40, 40]),
        centers_px=to_points(points)[[3, 0, 2, 1, 4, 5]],
        headings_rad=np.full(6, -np.pi / 2),
        sides_px=np.full(6, 20.0),
        corners_px=to_points((points[[3, 0, 2, 1, 4, 5], None] + corners).ravel()).reshape(-1, 4, 2),
        covariances=np.zeros((6, 3, 3)),
    )


@pytest.fixture(scope="module")
def decided(lab, seen):
    unit = lab.make_unit(0)
    unit._controller.rectifier = None
    decision = unit.see(seen, 100.0).decision
    return decision, view_of(decision, lab.template)


IMAGE = np.add.outer(np.arange(480) // 4, np.arange(640) // 8).astype(np.uint8)


def test_pages_have_image_markers_goals_and_poses(seen, decided) -> None:
    decision, view = decided
    made = {
        topic: plain(message)
        for topic, message in frame_log.pages(0, 320, 0.1, Sight(IMAGE, seen, seen, decision, view))
    }
    assert made.keys() == frame_log.TOPICS.keys() - {"/marker_poses"}
    for topic, message in made.items():
        assert_valid(message, frame_log.TOPICS[topic][1], topic)
    picture = cv2.imdecode(
        np.frombuffer(base64.b64decode(made["/image"]["data"]), np.uint8), cv2.IMREAD_GRAYSCALE
    )
    assert picture.shape == (240, 320)
    assert np.abs(picture.astype(int) - IMAGE[::2, ::2]).mean() < 3
    overlay = made["/overlay"]
    assert [text["text"] for text in overlay["texts"]] == ["3", "0", "2", "1", "40", "40"]
    loops = [drawn["points"] for drawn in overlay["points"] if drawn["type"] == 2]
    np.testing.assert_allclose(
        [[(p["x"], p["y"]) for p in loop] for loop in loops], (seen.corners_px + 0.5) / 2
    )
    goals = [(circle["position"]["x"], circle["position"]["y"]) for circle in overlay["circles"]]
    np.testing.assert_allclose(goals, (view.goals_px + 0.5) / 2)
    arrows = [drawn["points"] for drawn in overlay["points"] if drawn["type"] == 4][-view.ids.size :]
    starts = [(arrow[0]["x"], arrow[0]["y"]) for arrow in arrows]
    rows = [seen.ids.tolist().index(robot) for robot in view.ids]
    np.testing.assert_allclose(starts, (seen.centers_px[rows] + 0.5) / 2)


def test_poses_on_the_ground_are_in_metres(seen, decided) -> None:
    decision, view = decided
    (poses,) = [
        m
        for topic, m in frame_log.pages(2, 640, 0.1, Sight(IMAGE, seen, seen, decision, view))
        if topic == "/poses"
    ]
    places = {one["child_frame_id"]: one for one in poses["transforms"]}
    assert places.keys() == {f"unit/2/robot/{robot}" for robot in range(4)}
    assert {one["parent_frame_id"] for one in places.values()} == {"unit/2/ground"}
    x, y = (places["unit/2/robot/0"]["translation"][axis] for axis in "xy")
    u, v = seen.centers_px[1]
    assert (x, y) == pytest.approx((0.1 * (u - 319.5) / 20, -0.1 * (v - 239.5) / 20))
    # Forward is up in the image, a quarter turn counter-clockwise from x.
    assert places["unit/2/robot/0"]["rotation"]["z"] == pytest.approx(np.sin(np.pi / 4))


def test_image_without_decision_has_no_goals_and_poses(seen) -> None:
    made = dict(frame_log.pages(0, 640, 0.1, Sight(IMAGE, seen, seen)))
    assert made.keys() == {"/image", "/overlay"} and not made["/overlay"]["circles"]


@pytest.mark.parametrize("shape", [(1, 1), (3, 641), (9000, 8), (2, 8192)])
def test_images_of_any_size_are_drawn(seen, shape) -> None:
    nothing = replace(
        seen,
        **{
            name: getattr(seen, name)[:0]
            for name in (
                "ids",
                "centers_px",
                "headings_rad",
                "sides_px",
                "corners_px",
                "covariances",
                "qualities",
            )
        },
    )
    made = dict(frame_log.pages(0, 64, 0.1, Sight(np.zeros(shape, dtype=np.uint8), nothing, nothing)))
    assert made["/image"]["data"]


def finished(kept):
    """Return the messages of the preview that is being made, if there is one."""
    ends_s, made = time.monotonic() + PATIENCE_S, []
    while not made and not kept._maker.is_free:
        assert time.monotonic() < ends_s
        made = list(kept.done())
    return made


@pytest.mark.parametrize(("rate_hz", "pictures"), [(0.0, 0), (2.0, 10), (100.0, 50)])
def test_preview_rate_is_limited(seen, rate_hz, pictures) -> None:
    made = []
    with frame_log.FrameLog(0, rate_hz, 64, 0.1) as kept:
        for step in range(50):
            now = replace(seen, time_s=100 + 0.1 * step)
            kept.show(Sight(IMAGE[:4, :4], now, now))
            made += [topic for topic, _ in finished(kept)]
    assert made.count("/image") == pictures


def test_unfinished_preview_does_not_block(seen, monkeypatch) -> None:
    goes_on = threading.Event()

    def slow(*arguments):
        assert goes_on.wait(PATIENCE_S)
        return [("/image", arguments[3].image)]

    monkeypatch.setattr(frame_log, "pages", slow)
    with frame_log.FrameLog(0, 10.0, 64, 0.1) as kept:
        for step in range(5):
            now = replace(seen, time_s=100.0 + step)
            kept.show(Sight(IMAGE[step:], now, now))
            assert not list(kept.done())
        goes_on.set()
        ((_, shown),) = finished(kept)
        assert shown.shape == IMAGE.shape, "the first one; the others came while it was made"
        assert not list(kept.done())


@pytest.fixture
def slanting():
    """Return an image of four markers from a slanting camera, its calibration and the true poses."""
    camera, pose = Camera((640, 480), focal_px=700.0), CameraPose((-0.6, 0.1), 1.4, 0.3, (0.1, -0.45))
    positions_m = np.array([[0.0, 0.0], [0.3, 0.1], [-0.2, 0.15], [0.1, -0.25]])
    headings_rad = np.array([0.3, -1.0, 2.0, 3.0])
    renderer = Renderer("4X4_50", 0.1, Ground(6), Sensor(2.0, np.random.default_rng(6)))
    image = renderer.render(Shot(camera, pose, np.arange(4), positions_m, headings_rad))
    turn, eye_m = rotation_camera_world(pose), np.array([*pose.position_m, pose.height_m])
    true = {
        marker: (turn @ Rotation.from_euler("z", heading).as_matrix(), turn @ (np.array([*at, 0.0]) - eye_m))
        for marker, (at, heading) in enumerate(zip(positions_m, headings_rad, strict=True))
    }
    return image, Calibration((640, 480), camera.intrinsic_matrix(), np.zeros(0)), true


@pytest.mark.parametrize("one_plane", [True, False])
def test_calibrated_camera_records_poses(slanting, one_plane) -> None:
    """The largest of 24 errors exceeds 4 standard deviations with a chance of 0.15 %."""
    image, calibration, true = slanting
    meter = PoseMeter(calibration, 0.1, "4X4_50", one_plane)
    markers = create_detector("photometric").detect(image, time_s=5.0)
    sight = Sight(image, markers, markers[markers.ids == 1])
    made = {topic: plain(message) for topic, message in frame_log.pages(3, 320, 0.1, sight, meter)}
    assert_valid(made["/poses"], frame_log.TOPICS["/poses"][1], "/poses")
    record = made["/marker_poses"]
    assert sorted(record["ids"]) == [0, 1, 2, 3] and record["one_plane"] == one_plane
    for k, marker in enumerate(record["ids"]):
        found = Rotation.from_quat(record["quaternions"][k]).as_matrix()
        off = pose_difference(found, np.array(record["positions_m"][k]), *true[marker])
        assert np.abs(off / np.sqrt(np.diag(record["covariances"][k]))).max() < 4
        drawn = made["/poses"]["transforms"][k]
        assert drawn["parent_frame_id"] == "unit/3/camera"
        assert drawn["child_frame_id"] == f"unit/3/marker/{marker}"
        assert [drawn["translation"][axis] for axis in "xyz"] == record["positions_m"][k]
        assert [drawn["rotation"][axis] for axis in "xyzw"] == record["quaternions"][k]


def test_image_of_another_size_has_no_poses_but_a_reason(slanting, seen) -> None:
    image, calibration, _ = slanting
    with frame_log.FrameLog(0, 10.0, 64, 0.1, PoseMeter(calibration, 0.1, "4X4_50", True)) as kept:
        kept.show(Sight(image[:400], seen, seen))
        assert {topic for topic, _ in finished(kept)} == {"/image", "/overlay"}
        assert "640 x 400 px, calibrated at 640 x 480 px" in kept.trouble
        later = replace(seen, time_s=seen.time_s + 1)
        kept.show(Sight(image, later, later))
        assert "/marker_poses" in {topic for topic, _ in finished(kept)} and kept.trouble is None
