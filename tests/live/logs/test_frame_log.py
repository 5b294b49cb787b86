"""Previews of a unit's images: content, rate, and no blocking."""

import base64
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest
from live_sessions import small_lab
from plain_messages import assert_valid, plain

from skyherd.geometry import to_points
from skyherd.live.logs import frame_log
from skyherd.live.logs.view import view_of
from skyherd.messages import Detections

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
        topic: plain(message) for topic, message in frame_log.pages(0, 320, 0.1, IMAGE, seen, decision, view)
    }
    assert made.keys() == frame_log.TOPICS.keys()
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
        m for topic, m in frame_log.pages(2, 640, 0.1, IMAGE, seen, decision, view) if topic == "/poses"
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
    made = dict(frame_log.pages(0, 640, 0.1, IMAGE, seen, None, None))
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
    made = dict(frame_log.pages(0, 64, 0.1, np.zeros(shape, dtype=np.uint8), nothing, None, None))
    assert made["/image"]["data"]


@pytest.mark.parametrize(("rate_hz", "pictures"), [(0.0, 0), (2.0, 10), (100.0, 50)])
def test_preview_rate_is_limited(seen, rate_hz, pictures) -> None:
    made = []
    with frame_log.FrameLog(0, rate_hz, 64, 0.1) as kept:
        for step in range(50):
            kept.show(IMAGE[:4, :4], replace(seen, time_s=100 + 0.1 * step))
            if kept._made is not None:
                kept._made.result(PATIENCE_S)
            made += [topic for topic, _ in kept.done()]
    assert made.count("/image") == pictures


def test_unfinished_preview_does_not_block(seen, monkeypatch) -> None:
    goes_on = threading.Event()

    def slow(*arguments):
        assert goes_on.wait(PATIENCE_S)
        return [("/image", arguments[3])]

    monkeypatch.setattr(frame_log, "pages", slow)
    with frame_log.FrameLog(0, 10.0, 64, 0.1) as kept:
        for step in range(5):
            kept.show(IMAGE[step:], replace(seen, time_s=100.0 + step))
            assert not list(kept.done())
        waiting = kept._made
        goes_on.set()
        waiting.result(PATIENCE_S)
        ((_, shown),) = kept.done()
        assert shown.shape == IMAGE.shape, "the first one; the others came while it was made"
        assert not list(kept.done())
