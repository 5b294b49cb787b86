"""A recorded run on a page with a time bar, and as one HTML file."""

import base64
import re
import threading
from contextlib import contextmanager
from dataclasses import replace

import msgspec
import numpy as np
import pytest
import zstandard
from play_pages import moved, wait_until

from skyherd import load_mission, run_steps
from skyherd.datasets import read_interventions
from skyherd.drawing.palette import unit_rgb
from skyherd.play.messages import MessageFilter
from skyherd.play.replay import Replay, replay_data, replay_html
from skyherd.play.scene import GREY, drawn_grid_m
from skyherd.play.server import start_server, stop_server
from skyherd.play.session import End
from skyherd.play.view_page import PlayOrPause, Seek, ViewPage
from skyherd.report.access import Access, bind

SETTINGS = ["perception=ideal", "duration_s=12"]
KILL = {"kind": "kill", "unit": 1, "at_s": 4.0}
REVIVE = {"kind": "revive", "unit": 1, "at_s": 9.0}


@pytest.fixture(scope="module")
def run():
    """Return mission and steps of a run in which unit 1 dies at 4 s and is revived at 9 s."""
    mission = load_mission("star", SETTINGS).with_interventions(read_interventions([KILL, REVIVE]))
    return mission, list(run_steps(mission))


@pytest.fixture
def replay(run):
    with bind("127.0.0.1", 0) as listener:
        server = start_server(Access.make("127.0.0.1", listener.getsockname()[1]), listener, MessageFilter())
        yield Replay(server, *run)
        stop_server(server)


@pytest.fixture
def view(run):
    """Show the run on a page in a thread."""

    @contextmanager
    def showing():
        with bind("127.0.0.1", 0) as listener:
            page = ViewPage(*run, Access.make("127.0.0.1", listener.getsockname()[1]), listener)
            thread = threading.Thread(target=page.run)
            thread.start()
            try:
                yield page
            finally:
                page.ask(End())
                thread.join(20)
                page.close()
            assert not thread.is_alive()

    with showing() as page:
        yield page


def traces(replay):
    return replay.scene._lines["traces"]._node.points


class TestReplay:
    def test_times_are_found(self, replay):
        assert [replay.index_at(time_s) for time_s in (-1, 0, 0.05, 0.1, 3.0, 99)] == [0, 0, 0, 1, 30, 120]

    def test_objects_are_where_the_step_is(self, replay):
        for index in (100, 20):
            replay.draw(index)
            step = replay.steps[index]
            node, body = replay.scene._robots[5], replay.scene._units[2].body
            atol = drawn_grid_m(replay.mission) / 2
            np.testing.assert_allclose(node.position[:2], step.positions_m[5], rtol=0, atol=atol)
            place = [*step.fleet.positions_m[2], step.fleet.heights_m[2]]
            np.testing.assert_allclose(body.position, place, rtol=0, atol=atol)

    def test_rings_have_the_colours_of_the_units_that_control(self, replay):
        """A ring is divided between the units; viser takes light instead of sRGB values."""
        replay.draw(0)
        step = replay.steps[0]
        for row, robot in enumerate(replay.mission.ids.tolist()):
            units = [unit for unit, ids in step.control_sets.items() if robot in ids]
            node = replay.scene._rings[row]._node
            shown = {tuple(color) for color in node.colors[:, 0].tolist()}
            wanted = [unit_rgb(unit) for unit in units] or [GREY]
            assert shown == {tuple(np.rint(255 * (np.array(rgb) / 255) ** 2.2)) for rgb in wanted}
            assert node.name == f"/robots/{robot}/ring"

    def test_circles_are_at_the_points_of_the_shape(self, replay):
        """The circle's centre is the end of the way that starts at the robot."""
        replay.draw(30)
        step = replay.steps[30]
        ways = replay.scene._lines["ways"]._node.points
        goals = np.array([node._node.position for node in replay.scene._goals])
        np.testing.assert_allclose(ways[:, 1], goals, rtol=0, atol=1e-6)
        atol = drawn_grid_m(replay.mission) / 2 + 1e-6
        np.testing.assert_allclose(ways[:, 0, :2], step.positions_m, rtol=0, atol=atol)

    def test_traces_do_not_depend_on_the_way_to_a_time(self, replay):
        for index in range(0, 61, 3):
            replay.draw(index, with_images=False)
        played = traces(replay).copy()
        replay.draw(120, with_images=False)
        assert len(traces(replay)) > len(played)
        replay.draw(60, with_images=False)
        np.testing.assert_array_equal(traces(replay), played)

    def test_dead_unit_has_no_frustum_between_death_and_revival(self, replay):
        frustum = replay.scene._units[1].frustum
        for time_s, is_alive in ((2.0, True), (5.0, False), (10.0, True), (6.0, False), (1.0, True)):
            images = replay.draw(replay.index_at(time_s))
            assert frustum.visible == is_alive
            assert {image.unit for image in images} >= ({0, 1, 2} if is_alive else {0, 2})


class TestPage:
    def test_run_is_shown_to_its_end_and_again(self, view):
        view.ask(Seek(11.5))
        wait_until(lambda: view.is_paused and view.time_s == 12.0)
        wait_until(lambda: "12.0 s** · paused" in view._state.content)
        view.ask(PlayOrPause())
        wait_until(lambda: not view.is_paused and 0 < view.time_s < 5)

    def test_paused_page_stands_still_and_can_be_sought(self, view):
        view.ask(PlayOrPause())
        wait_until(lambda: view.is_paused)
        moved(view._bar, 7.3)
        wait_until(lambda: view._index == 73 and "kill" in view._events.content)
        assert view.time_s == 7.3 and view.is_paused and "revive" not in view._events.content

    def test_bar_that_follows_the_time_does_not_seek(self, view):
        wait_until(lambda: view._bar.value > 0.5)
        assert view._sought_s < 0

    def test_bar_refuses_times_outside_the_run(self, view):
        check = MessageFilter()
        check.register(view._bar)
        for time_s, is_allowed in ((5.0, True), (12.0, True), (12.1, False), (-0.1, False), (np.nan, False)):
            message = {"type": "GuiUpdateMessage", "uuid": view._bar._impl.uuid, "updates": {"value": time_s}}
            assert check.accepts(msgspec.msgpack.encode(message)) == is_allowed


def content_of(page):
    """Return the messages in an HTML file, as viser's client reads them."""
    (data,) = re.findall(r'__VISER_EMBED_DATA__="([^"]+)"', page)
    return unpacked(base64.b64decode(data))


def unpacked(packed):
    """Return the messages in viser's file of a scene."""
    inner = zstandard.ZstdDecompressor().decompress(packed[8:], int.from_bytes(packed[:8], "little"))
    return msgspec.msgpack.decode(inner[8 : 8 + int.from_bytes(inner[:8], "little")], strict=False)


class TestHtml:
    def test_file_has_the_whole_run(self, run):
        mission, steps = run
        content = content_of(replay_html(mission, steps))
        assert content["durationSeconds"] == pytest.approx(12.0)
        places = {}
        for time_s, message in content["messages"]:
            if message["type"] == "SetPositionMessage" and message["name"] == "/robots/5":
                places[round(time_s, 6)] = message["position"][:2]
        assert len(places) >= 50
        for time_s, place in places.items():
            step = steps[round(time_s / mission.scenario.step_s)]
            atol = drawn_grid_m(mission) / 2
            np.testing.assert_allclose(place, step.positions_m[5], rtol=0, atol=atol)

    def test_robots_at_rest_add_nothing_but_points_of_traces(self, run):
        mission, steps = run
        still = [replace(steps[0], time_s=0.1 * number) for number in range(30)]
        messages = content_of(replay_html(mission, still))["messages"]
        assert len(messages) > 100
        assert {message["name"] for time_s, message in messages if time_s > 0} == {"/lines/traces"}

    def test_images_of_a_file_are_small_and_few(self, run):
        """Each unit has an image at the start and, as robots move, every two seconds; a dead one has none."""
        mission, steps = run
        images = [
            (time_s, message["name"])
            for time_s, message in content_of(replay_html(mission, steps))["messages"]
            if "_image_data" in message.get("updates", {}) and time_s > 0
        ]
        assert {name for _, name in images} == {"/cameras/0", "/cameras/1", "/cameras/2"}
        for unit, most in ((0, 6), (1, 5), (2, 6)):
            times_s = [time_s for time_s, name in images if name == f"/cameras/{unit}"]
            assert 3 <= len(times_s) <= most
            assert min(np.diff(times_s)) > 1.9

    def test_data_is_what_the_page_holds(self, run):
        mission, steps = run
        page, data = replay_html(mission, steps[:20]), replay_data(mission, steps[:20])
        assert content_of(page)["durationSeconds"] == unpacked(data)["durationSeconds"]
        assert len(content_of(page)["messages"]) == len(unpacked(data)["messages"])

    def test_run_of_one_step_is_written(self, run):
        mission, steps = run
        assert content_of(replay_html(mission, steps[:1]))["durationSeconds"] == 0

    @pytest.mark.slow
    def test_file_is_shown_without_a_network(self, run, gl_browser, tmp_path):
        path = tmp_path / "run.html"
        path.write_text(replay_html(*run))
        with gl_browser("about:blank") as window:
            asked, failed = [], []
            window.on("request", lambda request: asked.append(request.url))
            window.on("pageerror", lambda error: failed.append(error))
            window.goto(path.as_uri())
            window.locator("canvas").first.wait_for()
            window.wait_for_function("Number(document.querySelector('input').value) > 1")
            assert {url.partition(":")[0] for url in asked} <= {"file", "blob", "data"}
            assert not failed
