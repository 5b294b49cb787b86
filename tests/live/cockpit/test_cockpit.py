"""The page of a live run: access, pictures, state, and the request to stop."""

import http.client
import json
import os
import time
from contextlib import closing
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.live.cockpit import Cockpit, PageAddress, PreviewWriter, ProcessState
from skyherd.live.cockpit.previews import WIDTH_PX, picture_path, read_preview
from skyherd.live.cockpit.server import Server
from skyherd.live.lab import load_lab
from skyherd.live.logs.view import View

LOOPBACK = PageAddress("127.0.0.1", 0)
WATCHED = SimpleNamespace(latch=SimpleNamespace(stopped=False))


@pytest.fixture
def server(tmp_path):
    with closing(Server(LOOPBACK, tmp_path, 2, "team test")) as server:
        yield server


def ask(access, method, path, **changed):
    """Return status, headers and body of a request; headers may be changed, or removed by None."""
    host = f"127.0.0.1:{access.port}"
    sent = {"Host": host, "Origin": f"http://{host}", "Cookie": f"{access.cookie}={access.token}", **changed}
    with closing(http.client.HTTPConnection("127.0.0.1", access.port, timeout=10)) as connection:
        connection.putrequest(method, path, skip_host=True)
        for name, value in sent.items():
            if value is not None:
                connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


class TestServer:
    def test_token_in_the_address_becomes_a_cookie(self, server) -> None:
        path = server.access.url.partition(str(server.access.port))[2]
        status, sent, _ = ask(server.access, "GET", path, Cookie=None, Origin=None)
        assert (status, sent["Location"]) == (303, "/")
        assert "HttpOnly" in sent["Set-Cookie"] and "SameSite=Strict" in sent["Set-Cookie"]

    @pytest.mark.parametrize("path", ["/", "/state", "/unit/0.jpg"])
    @pytest.mark.parametrize(
        "changed", [{"Cookie": None}, {"Host": "evil.example"}, {"Cookie": "skyherd_1=x"}]
    )
    def test_nothing_is_shown_without_the_token(self, server, path, changed) -> None:
        status, _, body = ask(server.access, "GET", path, **changed)
        assert status == 403 and body.startswith(b"refused")

    @pytest.mark.parametrize(
        "changed",
        [
            {"Cookie": None},
            {"Host": "evil.example"},
            {"Origin": None},
            {"Origin": "http://evil.example"},
            {"Origin": "null"},
        ],
        ids=str,
    )
    def test_foreign_request_cannot_stop(self, server, changed) -> None:
        assert ask(server.access, "POST", "/stop", **changed)[0] == 403
        assert not server.stop_asked()

    def test_only_a_post_to_stop_stops(self, server) -> None:
        """The last request is the negative control."""
        for method, path in (("GET", "/stop"), ("POST", "/arm"), ("POST", "/"), ("PUT", "/stop")):
            assert ask(server.access, method, path)[0] in (404, 501)
        assert not server.stop_asked()
        assert ask(server.access, "POST", "/stop")[0] == 202
        assert server.stop_asked() and not server.stop_asked()

    def test_paths_outside_of_the_page_do_not_exist(self, server, tmp_path) -> None:
        (tmp_path / "secret.jpg").write_bytes(b"x")
        for path in ("/unit/../secret.jpg", "/secret.jpg", "/unit/2.jpg", "//etc/passwd", "/unit/0.json"):
            assert ask(server.access, "GET", path)[0] == 404

    def test_page_runs_no_foreign_script(self, server) -> None:
        _, sent, body = ask(server.access, "GET", "/")
        policy = sent["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy
        nonce = policy.partition("script-src 'nonce-")[2].partition("'")[0]
        assert body.count(b"<script") == 1 and f'<script nonce="{nonce}">'.encode() in body

    def test_taken_port_is_one_error(self, server, tmp_path) -> None:
        with pytest.raises(InputError, match=r"^port: "):
            Server(PageAddress("127.0.0.1", server.access.port), tmp_path, 1, "other")

    def test_silent_browsers_hold_nothing(self, server) -> None:
        silent = [http.client.HTTPConnection("127.0.0.1", server.access.port, timeout=10) for _ in range(20)]
        for connection in silent:
            connection.connect()
        assert ask(server.access, "POST", "/stop")[0] == 202 and server.stop_asked()
        for connection in silent:
            connection.close()


def wait_until(condition) -> None:
    """Wait until a condition is true."""
    ends_s = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < ends_s


class TestPreviews:
    def test_picture_shows_markers_and_ways_at_their_places(self, tmp_path, make_detections) -> None:
        """An image of twice the width of the picture: all places are halved."""
        image = np.full((800, 2 * WIDTH_PX), 128, np.uint8)
        found = make_detections([3, 5], np.array([200 + 300j, 900 + 500j]), size=(2 * WIDTH_PX, 800))
        view = View(0.0, np.array([5]), np.array([[1100.0, 500.0]]), 0.1, 2)
        with PreviewWriter(tmp_path, 1) as writer:
            writer.show(image, found, view, None)
        preview, age_s = read_preview(tmp_path, 1)
        assert (preview.seen, preview.controlled, preview.trouble) == ([3, 5], [5], "")
        assert age_s < 60
        picture = cv2.imread(str(picture_path(tmp_path, 1))).astype(int)
        assert picture.shape == (400, WIDTH_PX, 3)
        changed = np.abs(picture - 128).max(axis=2) > 20
        assert changed[250, 500:548].mean() > 0.8, "the way to the goal"
        assert not changed[250, 560:].any() and changed[140:161, 90:111].any()

    def test_picture_is_written_at_most_twice_a_second(self, tmp_path, make_detections) -> None:
        found = make_detections([3], np.array([40 + 30j]), size=(80, 60))
        with PreviewWriter(tmp_path, 0) as writer:
            for trouble in ("frozen", "too soon"):
                writer.show(np.zeros((60, 80), np.uint8), found, None, trouble)
                wait_until(lambda: read_preview(tmp_path, 0))
        assert read_preview(tmp_path, 0)[0].trouble == "frozen"

    def test_full_disk_does_not_end_the_unit(self, tmp_path, make_detections) -> None:
        found = make_detections([3], np.array([40 + 30j]), size=(80, 60))
        with PreviewWriter(tmp_path / "gone", 0) as writer:
            (tmp_path / "gone").rmdir()
            writer.show(np.zeros((60, 80), np.uint8), found, None, None)
            wait_until(lambda: writer._maker.take() or writer._maker.is_free)
        assert read_preview(tmp_path / "gone", 0) is None

    @pytest.mark.parametrize("text", ["", "{", "[]", '{"unit": 1}', '{"unit": 0, "seen": 3}', "\xff"])
    def test_damaged_record_counts_as_no_picture(self, tmp_path, text) -> None:
        (tmp_path / "unit_0.json").write_bytes(text.encode("latin-1"))
        assert read_preview(tmp_path, 0) is None

    def test_without_a_folder_nothing_is_made(self, tmp_path, make_detections) -> None:
        with PreviewWriter(None, 0) as writer:
            writer.show(np.zeros((60, 80), np.uint8), make_detections([], []), None, None)
            assert writer._maker.is_free


class TestCockpit:
    def test_state_has_sight_control_and_overlap(self, tmp_path, make_detections) -> None:
        """Two of three units share two robots; the third, which sees no other robot, is apart."""
        lab = load_lab("star", [])
        with closing(Cockpit(lab, tmp_path, LOOPBACK)) as cockpit:
            for unit, ids in enumerate(([0, 1, 2, 3], [2, 3, 4], [9])):
                found = make_detections(ids, 100 * (1 + np.arange(len(ids))) + 100j)
                view = View(0.0, np.array(ids[:2]), np.ones((len(ids[:2]), 2)), 0.1, 2)
                with PreviewWriter(tmp_path, unit) as writer:
                    writer.show(np.zeros((800, 800), np.uint8), found, view, None)
            processes = [
                ProcessState("unit/0", 2, None, "4 markers"),
                ProcessState("robot/3", 1, True, "driving"),
            ]
            cockpit.show(processes, WATCHED, ["a line"])
            state = json.loads(ask(cockpit._server.access, "GET", "/state")[2])
        robots = {robot["robot"]: robot for robot in state["robots"]}
        assert state["armed"] == 1 and state["lines"] == ["a line"]
        assert (robots[3]["seen"], robots[3]["controlled"], robots[3]["armed"]) == ("0, 1", "1", "ARMED")
        assert (robots[7]["seen"], robots[7]["armed"]) == ("", "?")
        assert state["units"][0]["state"] == "4 markers (start 2)"
        assert not state["units"][0]["old"]
        said = "\n".join(finding["text"] for finding in state["findings"])
        assert "cameras 0 and 1 share robots 2, 3" in said
        assert "camera 2 shares fewer than 2 robots" in said
        assert "robots 5, 6, 7, 8, 10" in said and "controlled by no unit" in said

    def test_old_picture_is_marked_and_counts_as_blind(self, tmp_path, make_detections) -> None:
        lab = load_lab("triangle", [])
        with PreviewWriter(tmp_path, 0) as writer:
            writer.show(np.zeros((800, 800), np.uint8), make_detections([0], [100 + 100j]), None, None)
        record = tmp_path / "unit_0.json"
        os.utime(record, (record.stat().st_atime, record.stat().st_mtime - 9))
        with closing(Cockpit(lab, tmp_path, LOOPBACK)) as cockpit:
            cockpit.show([], WATCHED, [])
            state = json.loads(ask(cockpit._server.access, "GET", "/state")[2])
        assert state["units"][0]["old"] and state["units"][0]["age_s"] >= 9
        assert state["robots"][0]["seen"] == ""


class TestBrowser:
    @pytest.fixture
    def opened(self, tmp_path, browser):
        lab = load_lab("triangle", [])
        with closing(Cockpit(lab, tmp_path, LOOPBACK)) as cockpit:
            evil = "<img src=x onerror=document.title='evil'>"
            cockpit.show([ProcessState("robot/0", 1, True, evil)], WATCHED, [evil])
            page = browser.new_page(viewport={"width": 390, "height": 844})
            page.goto(cockpit.url)
            page.get_by_text("1 of 6 robots armed").wait_for()
            yield cockpit, page, evil
            page.close()

    def test_stop_is_asked_by_button_and_by_space_bar(self, opened) -> None:
        cockpit, page, _ = opened
        assert not cockpit.stop_asked()
        for act in (lambda: page.locator("#stop").click(), lambda: page.keyboard.press(" ")):
            with page.expect_response("**/stop") as answer:
                act()
            assert answer.value.status == 202 and cockpit.stop_asked()

    @pytest.mark.parametrize("width", [390, 1280])
    def test_page_is_comfortable_on_a_phone_and_a_desktop(self, opened, width, assert_comfortable) -> None:
        _, page, _ = opened
        page.set_viewport_size({"width": width, "height": 844})
        assert_comfortable(page)
        picture = page.locator("#units figure").first.bounding_box()
        assert picture["width"] == (390 if width == 390 else pytest.approx(360, abs=40))
        right = page.evaluate("document.querySelector('#robots td:last-child').getBoundingClientRect().right")
        assert right <= width, "without scrolling"

    def test_names_are_text_and_the_page_fits_a_phone(self, opened) -> None:
        _, page, evil = opened
        assert evil in page.locator("#robots").inner_text() and evil in page.locator("#lines").inner_text()
        assert page.locator("#robots img").count() == 0 and "evil" not in page.title()
        width, window = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
        assert width <= window
        assert not page.get_by_role("button", name="arm").count()

    def test_lost_run_is_told(self, opened) -> None:
        cockpit, page, _ = opened
        cockpit.close()
        page.locator("#stop").click()
        page.get_by_text("STOP WAS NOT SENT").wait_for()
        cockpit._server._http = SimpleNamespace(shutdown=lambda: None, server_close=lambda: None)
