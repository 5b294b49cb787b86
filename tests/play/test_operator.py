"""An operator with a mouse, in a browser, disturbs the run and draws shapes."""

import numpy as np
import pytest
from play_pages import wait_until

from skyherd.control import fit_similarity
from skyherd.datasets import load_mission, polyline_points
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.play.poses import VIEW_FOV_RAD
from skyherd.play.session import SetSpeed
from skyherd.play.sketch import ground_point

TRIANGLE_M = np.array([[-6.0, -5.0], [6.0, -5.0], [0.0, 5.0]])


def pixel_of(page, window, point_m):
    """Return where the browser shows a point (3,), m: pixels of its window."""
    (client,) = page.server.get_clients().values()
    camera = client.camera
    place, looked_at = np.array(camera.position), np.array(camera.look_at)
    ahead = (looked_at - place) / np.linalg.norm(looked_at - place)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    away = np.array(point_m) - place
    depth = away @ ahead
    size = np.array([window.viewport_size["width"], window.viewport_size["height"]])
    focal_px = size[1] / 2 / np.tan(VIEW_FOV_RAD / 2)
    u, v = away @ right, -away @ np.cross(right, ahead)
    return size / 2 + focal_px * np.array([u, v]) / depth


def test_ray_meets_the_ground_below_the_camera_only() -> None:
    up = np.array([1.0, 2.0, 4.0])
    np.testing.assert_allclose(ground_point(up, np.array([0.0, 1.0, -2.0])), [1.0, 4.0])
    for direction in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, -1e-6]):
        assert ground_point(up, np.array(direction)) is None
    assert ground_point(-up, np.array([0.0, 0.0, -1.0])) is None


@pytest.mark.slow
@pytest.mark.parametrize("size_px", [(1280, 800), (390, 844)])
def test_shape_is_drawn_by_clicks_and_formed(open_page, gl_browser, size_px):
    with open_page(speed=4.0) as page, gl_browser(page.access.url, *size_px) as window:
        session = page.session
        window.get_by_role("tab", name="Team").click()
        window.get_by_role("button", name="Draw", exact=True).click()
        sketch = page._panel._sketch
        window.get_by_role("button", name="Discard").wait_for()
        for number, corner in enumerate(np.concatenate([TRIANGLE_M, TRIANGLE_M[:1]])):
            window.wait_for_timeout(300)
            window.mouse.click(*pixel_of(page, window, [*corner, 0.0]).tolist())
            wait_until(lambda seen=number: sketch.count == seen + 1)
        drawn = np.array(sketch._corners)
        np.testing.assert_allclose(drawn, TRIANGLE_M[[0, 1, 2, 0]], atol=0.4)  # three pixels
        window.get_by_role("button", name="Form the drawn shape").click()
        wait_until(lambda: session.added)
        assert not sketch.is_on
        begun_s = session._step.time_s
        wait_until(lambda: session._step.time_s > begun_s + 10 and session._step.metrics.shape.error < 0.01)
        places, line = polyline_points(drawn, 16)
        formed = to_complex(session._step.positions_m[session.added[-1].outline[0]])
        fit = fit_similarity(to_complex(places[line]), formed)
        assert np.abs(fit(to_complex(places[line])) - formed).max() < 0.05 * np.ptp(formed.real)


def drag(window, slider, shares):
    """Drag the thumb of a slider to shares of its range, one a second."""
    slider.scroll_into_view_if_needed()
    box = slider.locator("xpath=ancestor::*[contains(@class, 'mantine-Slider-root')]").bounding_box()
    middle = box["y"] + box["height"] / 2
    window.mouse.move(box["x"] + 0.5 * box["width"], middle)
    window.mouse.down()
    for share in shares:
        window.mouse.move(box["x"] + share * box["width"], middle, steps=10)
        window.wait_for_timeout(1000)
    window.mouse.up()


def drag_in_scene(window, start, way):
    """Drag from a pixel by a way, pixels."""
    window.mouse.move(*start.tolist())
    window.wait_for_timeout(500)  # the arrow below the pointer lights up
    window.mouse.down()
    window.mouse.move(*(start + way).tolist(), steps=10)
    window.mouse.up()


def errors_of(steps, since_s, until_s):
    return np.array([step.metrics.shape.error for step in steps if since_s <= step.time_s <= until_s])


@pytest.mark.slow
def test_team_recovers_and_the_session_repeats(open_page, gl_browser, tmp_path):
    """Zoom is dragged through its range while the star forms, a camera tilted, a robot dragged away."""
    sampled = {}
    with open_page(speed=0.5) as page, gl_browser(page.access.url) as window:
        session = page.session

        def wait(condition, wait_s=60):
            def sampling():
                sampled[session._step.time_s] = session._step
                return condition(session._step)

            wait_until(sampling, wait_s)

        window.get_by_role("tab", name="Cameras").click()
        window.get_by_text("change unit 0").click()
        drag(window, window.get_by_role("slider").nth(1), (0.0, 1.0, 0.1))
        wait(lambda step: {0.5, 2.5} <= {one.zoom for one in session.added} and session.added[-1].zoom < 0.9)
        window.get_by_text("change unit 0").click()
        window.get_by_text("change unit 1").click()
        drag(window, window.get_by_role("slider").nth(3), (50 / 60,))
        wait(lambda step: session.added[-1].kind == "unit" and session.added[-1].tilt_deg[0] >= 19.0)
        touched_s = session._step.time_s
        assert session._step.metrics.shape.error > 0.01
        session.ask(SetSpeed(4.0))
        wait(lambda step: step.time_s > touched_s + 20 and step.metrics.shape.error < 0.01)
        formed_s = session._step.time_s

        window.get_by_role("tab", name="Team").click()
        page._panel.choose("robot 5")
        wait(lambda step: page._panel._grab._held is not None and page._panel._grab._held.node.visible)
        robot_m = session._step.positions_m[5].copy()
        x, y = robot_m.tolist()
        arrow = [x + 0.8 * page._panel._grab._size_m, y, 0.0]
        drag_in_scene(window, pixel_of(page, window, arrow), np.array([60.0, 0.0]))
        wait(lambda step: session.added[-1].kind == "robot")
        wait(lambda step: np.linalg.norm(session.added[-1].position_m - robot_m) > 1.0)
        wait(lambda step: step.time_s > session.added[-1].at_s + 1 and step.metrics.shape.error < 0.01)

        window.keyboard.press("s")
        wait(lambda step: any(tmp_path.glob("star-played*.toml")))
        last_s = max(sampled)
    (saved,) = tmp_path.glob("star-played*.toml")
    repeated = list(run_steps(load_mission(saved, {"duration_s": last_s + 1.0})))
    by_time = {step.time_s: step for step in repeated}
    assert len(sampled) > 100 and all(time_s in by_time for time_s in sampled)
    for time_s, step in sampled.items():
        np.testing.assert_array_equal(step.command.v_mps, by_time[time_s].command.v_mps)
        np.testing.assert_array_equal(step.positions_m, by_time[time_s].positions_m)
    untouched = list(run_steps(load_mission("star", {"perception": "ideal", "duration_s": formed_s})))
    since_s = touched_s + 10
    errors, own = errors_of(repeated, since_s, formed_s), errors_of(untouched, since_s, formed_s)
    assert errors.size == own.size > 50 and (errors <= own + 0.005).all()


@pytest.mark.slow
def test_killed_unit_is_taken_over_and_revived(open_page, gl_browser):
    with open_page("crowd", speed=4.0) as page, gl_browser(page.access.url) as window:
        session = page.session
        wait_until(lambda: len(session._step.control_sets[1]) == 16, 60)
        window.get_by_role("tab", name="Cameras").click()
        window.get_by_text("change unit 1").click()
        window.get_by_role("button", name="Kill unit 1").click()
        wait_until(lambda: not len(session._step.control_sets[1]))
        wait_until(lambda: len(session._step.control_sets[0]) == 16)
        window.get_by_role("button", name="Revive unit 1").click()
        wait_until(lambda: len(session._step.control_sets[1]) >= 2)
        assert session._step.metrics.shape.error < 0.01
