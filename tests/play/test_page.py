"""The page of `skyherd play` in a browser, and what it shows without one."""

import numpy as np
import pytest
import viser
from play_pages import wait_until

from skyherd.datasets import load_mission, read_interventions
from skyherd.markers.dictionary import marker_cells
from skyherd.play import page as page_module
from skyherd.play.pictures import ground_picture, marker_picture
from skyherd.play.poses import VIEW_FOV_RAD, Window, field_of_view_rad, view_of, wxyz_about_z, wxyz_of
from skyherd.play.scene import corners_m, drawn_grid_m
from skyherd.play.session import Change, Pause, Restart, SingleStep
from skyherd.play.wording import describe, escaped
from skyherd.report.access import Access


class TestScene:
    def test_nodes_are_where_the_step_is(self, open_page):
        with open_page() as page:
            scene, session = page._scene, page.session
            session.ask(Pause(True))
            wait_until(lambda: session.is_paused and page._step is session._step and not page._news.qsize())
            session.ask(SingleStep())
            grid_m, unit = drawn_grid_m(session.mission), scene._units[1].body

            def is_drawn() -> bool:
                fleet = session._step.fleet
                there = [*_place(page), *fleet.positions_m[1], fleet.heights_m[1]]
                drawn = [*scene._robots[5].position[:2], *unit.position]
                return page._step is session._step and np.allclose(drawn, there, rtol=0, atol=grid_m / 2)

            wait_until(is_drawn)
            assert len(scene._robots) == 16 and len(scene._units) == 3

    def test_dead_unit_loses_frustum_and_colour(self, open_page):
        with open_page() as page:
            page.session.ask(Change(({"kind": "kill", "unit": 1},)))
            wait_until(lambda: not page._scene._units[1].frustum.visible)
            assert page._scene._units[1].painted[0].color != page._scene._units[0].painted[0].color
            assert page._scene._units[0].frustum.visible

    def test_restart_clears_traces_and_events(self, open_page):
        with open_page(speed=1.0) as page:
            page.session.ask(Change(({"kind": "cover", "marker": 1},)))
            wait_until(lambda: page._panel._events)
            page.session.ask(Restart(2))
            wait_until(lambda: page.session.seed == 2 and not page._panel._events)
            assert 0 < len(page._scene._past_m) <= len(page._panel._curves) < 100

    def test_images_are_shown_of_every_camera(self, open_page):
        with open_page("triangle", ["units.*.camera.size_px=[120,80]"]) as page:
            wait_until(lambda: all(unit.frustum.image is not None for unit in page._scene._units))
            height, width, _ = page._scene._units[0].frustum.image.shape
            assert width / height == pytest.approx(1.5, rel=0.02)

    @pytest.mark.parametrize("name", ["obstacles", "tree", "letters", "failure"])
    def test_built_in_scenario_is_shown(self, open_page, name):
        with open_page(name) as page:
            wait_until(lambda: page._step is not None and page._step.time_s > 0.5)


def _place(page):
    return page.session._step.positions_m[5]


class TestGeometry:
    def test_drawn_grid_is_below_a_hundredth_of_a_marker(self):
        """It is a power of two, so that numbers on it have few digits."""
        for side_m in (0.02, 0.3, 1.0, 7.0):
            grid_m = drawn_grid_m(load_mission("star", [f"marker.side_m={side_m}"]))
            assert side_m / 200 < grid_m <= side_m / 100
            assert np.log2(grid_m) == round(np.log2(grid_m))

    def test_drawn_angles_are_right_to_a_thirtieth_of_a_degree(self):
        for angle_rad in np.linspace(-np.pi, np.pi, 1001):
            w, _, _, z = wxyz_about_z(angle_rad)
            error_rad = np.angle(np.exp(1j * (2 * np.arctan2(z, w) - angle_rad)))
            assert abs(np.degrees(error_rad)) < 1 / 30 and abs(np.hypot(w, z) - 1) < 3e-4

    def test_ground_picture_holds_the_robots(self):
        """It is pale, and shows the ground around all robots."""
        mission = load_mission("star")
        picture, center_m, side_m = ground_picture(mission)
        assert picture.shape == (1024, 1024, 3) and picture.min() > 100
        assert (np.abs(mission.positions_m - center_m) < side_m / 2).all()

    def test_marker_picture_has_its_cells_in_order(self):
        picture = marker_picture("4X4_50", 7, pixels=4)
        cells = marker_cells("4X4_50", 7)
        margin = (len(picture) - 4 * len(cells)) // 2
        inner = picture[margin : margin + 4 * len(cells), margin : margin + 4 * len(cells), 0]
        np.testing.assert_array_equal(inner[2::4, 2::4] > 0, cells)

    def test_quaternion_turns_as_its_matrix(self):
        angle = 0.7
        matrix = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        np.testing.assert_allclose(wxyz_of(matrix), wxyz_about_z(angle), atol=1e-12)

    def test_field_of_view_follows_zoom(self):
        camera = load_mission("star").cameras_at(0.0)[0]
        assert field_of_view_rad(camera, 1.0) == pytest.approx(np.radians(78.0))
        assert np.tan(field_of_view_rad(camera, 2.0) / 2) == pytest.approx(np.tan(np.radians(39.0)) / 2)


@pytest.mark.parametrize(("speed", "name"), [(1.0, "1 ×"), (0.1, "0.1 ×"), (None, "as fast as possible")])
def test_any_speed_of_the_command_line_is_shown(open_page, speed, name):
    with open_page(speed=speed) as page:
        assert page._panel._speed.value == name


class TestView:
    @pytest.mark.parametrize("size_px", [(1280, 800), (1920, 1080), (390, 844), (800, 600)])
    @pytest.mark.parametrize("name", ["star", "handheld"])
    def test_first_view_shows_the_team_beside_the_panel(self, name, size_px):
        """Points are projected by a camera that looks along the line of sight, with z up."""
        points_m, window = corners_m(load_mission(name)), Window.of(*size_px)
        place, looked_at = map(np.array, view_of(points_m, window))
        ahead = (looked_at - place) / np.linalg.norm(looked_at - place)
        right = np.cross(ahead, [0, 0, 1])
        right /= np.linalg.norm(right)
        above = np.cross(right, ahead)
        tangent = np.tan(VIEW_FOV_RAD / 2)
        depth = (points_m - place) @ ahead
        u = (points_m - place) @ right / depth / tangent / window.aspect
        v = (points_m - place) @ above / depth / tangent
        tolerance = 1e-9
        assert depth.min() > 0
        assert u.min() >= window.u[0] - tolerance and u.max() <= window.u[1] + tolerance
        assert v.min() >= window.v[0] - tolerance and v.max() <= window.v[1] + tolerance
        fills = [np.ptp(seen) / (high - low) for seen, (low, high) in ((u, window.u), (v, window.v))]
        assert max(fills) == pytest.approx(1)


def test_end_does_not_wait_for_the_next_drawing(open_page, monkeypatch):
    """After a drawing that took long, as on a busy machine, the pause is long, too."""
    monkeypatch.setattr(page_module, "MIN_INTERVAL_S", 60.0)
    with open_page() as page:
        wait_until(lambda: page._step is not None and page._news.qsize() > 5)


def test_text_of_external_source_has_no_markup():
    assert not set(escaped("[x](javascript:1) <b> `a` **b** ![i](u) \n# h")) & set("[]<>`*!#\n")


def test_events_name_target_and_values():
    tables = [
        ({"kind": "camera", "unit": 0, "zoom": 1.25}, "camera unit 0 zoom 1.25"),
        ({"kind": "robot", "robot": 4, "position_m": [9.0, 1.0]}, "robot 4 position_m (9, 1)"),
        ({"kind": "kill", "unit": 2}, "kill unit 2"),
        ({"kind": "template", "shape": "word:SKY"}, "template shape word:SKY"),
    ]
    for table, said in tables:
        assert describe(read_interventions([{**table, "at_s": 1}])[0]) == said


class TestBrowser:
    def test_page_shows_and_pauses_the_run(self, open_page, gl_browser):
        with open_page(speed=1.0) as page, gl_browser(page.access.url) as window:
            assert page.access.token not in window.url
            window.get_by_text("shape error").first.wait_for()
            window.get_by_role("button", name="Pause (P)").click()
            wait_until(lambda: page.session.is_paused)
            time_s = page.session._step.time_s
            window.get_by_role("button", name="Single step (N)").click()
            wait_until(lambda: page.session._step.time_s > time_s)
            window.get_by_role("button", name="Continue (P)").click()
            wait_until(lambda: not page.session.is_paused)
            window.keyboard.press("p")
            wait_until(lambda: page.session.is_paused)
            assert window.get_by_text("share", exact=False).count() == 0

    @pytest.mark.slow
    @pytest.mark.parametrize("size_px", [(1280, 800), (390, 844)])
    def test_window_of_any_size_begins_with_the_whole_team(self, open_page, gl_browser, size_px):
        with open_page(speed=1.0) as page, gl_browser(page.access.url, *size_px) as window:
            window.get_by_role("button", name="Pause (P)").wait_for()
            wait_until(lambda: page.server.get_clients())
            (client,) = page.server.get_clients().values()
            place, _ = view_of(corners_m(page.session.mission), Window.of(*size_px))
            wait_until(lambda: np.allclose(client.camera.position, place, rtol=1e-4))
            widths = window.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
            assert widths[0] <= widths[1]

    @pytest.mark.slow
    @pytest.mark.parametrize(("size_px", "control_px"), [((390, 844), 44), ((1280, 800), 24)])
    def test_page_is_comfortable_in_every_tab(
        self, open_page, gl_browser, assert_comfortable, size_px, control_px
    ):
        """On a desktop, arrows beside numbers are lower. Notices of software rendering are viser's."""
        with open_page(speed=1.0) as page, gl_browser(page.access.url, *size_px) as window:
            window.get_by_role("button", name="Pause (P)").click()
            for tab in ("Run", "Cameras", "Team"):
                window.get_by_role("tab", name=tab).click()
                window.add_style_tag(content=".mantine-NumberInput-controls { display: none; }")
                window.wait_for_timeout(300)
                assert_comfortable(window, control_px)
            panel = window.get_by_role("tab", name="Run").locator(
                "xpath=ancestor::*[contains(@class, 'Paper')]"
            )
            box = panel.first.bounding_box()
            if size_px[0] == 390:
                assert box["width"] == 390 and box["height"] <= 0.5 * size_px[1] + 1

    @pytest.mark.slow
    def test_zoom_slider_changes_the_zoom_and_the_shape_is_reached(self, open_page, gl_browser):
        with open_page(speed=4.0) as page, gl_browser(page.access.url) as window:
            session = page.session
            window.get_by_role("tab", name="Cameras").click()
            window.get_by_text("change unit 0").click()
            window.get_by_role("slider").nth(1).press("End")
            wait_until(lambda: session.added)
            assert session.added[-1].zoom == 2.5
            wait_until(lambda: session._step.fleet.zooms[0] == 2.5)
            goal = session.mission.scenario.goal.shape_error
            wait_until(lambda: session._step.metrics.shape.error < goal, wait_s=60)
            window.get_by_role("tab", name="Run").click()
            window.get_by_text("shape reached").wait_for()
            window.get_by_text("camera unit 0 zoom 2.5").wait_for()

    @pytest.mark.slow
    def test_page_of_foreign_origin_is_refused(self, open_page, gl_browser, foreign_page, monkeypatch):
        """It is on another port of this computer, so that the browser sends the cookie, too."""
        with open_page(speed=1.0) as page, gl_browser(page.access.url) as window:
            window.get_by_role("button", name="Pause (P)").wait_for()
            wait_until(lambda: len(page.server.get_clients()) == 1)
            own = page.access.url.partition("/?")[0]
            assert window.evaluate(ATTEMPTS, own) == {"socket": "opened", "text": 200}
            window.goto(foreign_page)
            wait_until(lambda: not page.server.get_clients())
            asked = refusals(monkeypatch)
            assert window.evaluate(ATTEMPTS, own) == {"socket": "refused", "text": "refused"}
            assert [reason for _, reason in asked] == ["foreign origin"] * 2
            assert all(page.access.token in headers["Cookie"] for headers, _ in asked)


def refusals(monkeypatch):
    """Return the list that receives headers and outcome of each request."""
    found, refusal = [], Access.refusal

    def spy(access, headers, *, is_socket):
        found.append((headers, refusal(access, headers, is_socket=is_socket)))
        return found[-1][1]

    monkeypatch.setattr(Access, "refusal", spy)
    return found


ATTEMPTS = f"""async own => {{
    const socket = await new Promise(done => {{
        const one = new WebSocket(own.replace("http", "ws"), "viser-v{viser.__version__}");
        one.onopen = () => {{ one.close(); done("opened"); }};
        one.onerror = () => done("refused");
    }});
    const read = fetch(own + "/", {{credentials: "include"}});
    const text = await read.then(answer => answer.status, () => "refused");
    return {{socket, text}};
}}"""
"""Script that tries to open a WebSocket of the page at an address, and to read it."""
