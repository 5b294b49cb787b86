"""`skyherd report`: the run in 3-D on its page, and a page that can be sent alone."""

import html
import re
import shutil

import pytest
from command_line import call


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from skyherd import load_mission, run_mission

    folder = tmp_path_factory.mktemp("run") / "triangle"
    run_mission(load_mission("triangle", ["perception=ideal", "duration_s=2"]), folder, video=True)
    return folder


def test_report_shows_the_replay_and_replaces_its_own(folder, capsys) -> None:
    replay = folder / "replay.html"
    assert "<iframe" not in (folder / "report.html").read_text()
    for _ in range(2):
        assert call(capsys, "report", folder, "--replay")[0] == 0
    assert '<iframe class="replay" src="replay.html"' in (folder / "report.html").read_text()
    replay.write_text("mine")
    code, _, err = call(capsys, "report", folder, "--replay")
    assert code == 2 and err.count("\n") == 1 and "replay.html" in err and replay.read_text() == "mine"
    replay.unlink()
    assert call(capsys, "report", folder)[0] == 0
    assert "<iframe" not in (folder / "report.html").read_text()


def test_page_in_a_browser_draws_the_replay(folder, capsys, gl_browser) -> None:
    assert call(capsys, "report", folder, "--replay")[0] == 0
    for width in (1280, 390):
        with gl_browser((folder / "report.html").as_uri(), width, 844) as window:
            window.locator("iframe.replay").scroll_into_view_if_needed()
            canvas = window.frame_locator("iframe.replay").locator("canvas")
            canvas.first.wait_for()
            box = canvas.first.bounding_box()
            assert box["width"] > 0.8 * min(width, 1100) and box["height"] > 300
            assert window.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_page_that_is_sent_alone_needs_no_other_file(folder, capsys, gl_browser, tmp_path) -> None:
    assert call(capsys, "report", folder, "--replay", "--embed")[0] == 0
    page = tmp_path / "mail.html"
    shutil.copy(folder / "report.html", page)
    (frame,) = re.findall(r'<iframe class="replay" srcdoc="([^"]*)"', page.read_text())
    assert html.unescape(frame) == (folder / "replay.html").read_text()
    with gl_browser("about:blank") as window:
        asked = []
        window.on("request", lambda request: asked.append(request.url))
        window.goto(page.as_uri())
        for shape in ("wide", "phone"):
            window.evaluate(f"document.querySelector('video.{shape}').load()")
            window.wait_for_function(f"document.querySelector('video.{shape}').readyState >= 1")
        window.locator("iframe.replay").scroll_into_view_if_needed()
        window.frame_locator("iframe.replay").locator("canvas").first.wait_for()
        assert {url for url in asked if not url.startswith(("data:", "blob:", "about:"))} == {page.as_uri()}
    assert call(capsys, "report", folder)[0] == 0
    assert 'src="video.mp4"' in (folder / "report.html").read_text()


@pytest.mark.parametrize("option", ["--replay", "--embed"])
def test_options_of_simulated_runs_are_refused_for_live_ones(option, capsys, tmp_path) -> None:
    (tmp_path / "robot_0.mcap").touch()
    code, _, err = call(capsys, "report", tmp_path, option)
    assert code == 2 and err.count("\n") == 1 and option in err and "of a live run" in err
