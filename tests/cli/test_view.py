"""`skyherd view`: the HTML file, refusals, and the page."""

import os
import re
import signal
import subprocess
import sys
import time

import pytest
from command_line import assert_refused, call

from skyherd import load_mission, run_steps
from skyherd.recording.writer import McapRecorder
from skyherd.report.access import bind


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Work in a folder with a short run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    mission = load_mission("triangle", ["perception=ideal", "duration_s=2"])
    with McapRecorder(tmp_path / "run" / "run.mcap", mission) as recorder:
        for step in run_steps(mission):
            recorder.write(step)
        recorder.finish(step.time_s, 1.0)
    return tmp_path


@pytest.mark.parametrize("run", ["run", "run/run.mcap"])
def test_html_file_is_written_once(here, capsys, run):
    assert call(capsys, "view", run, "--html", "a.html")[:2] == (0, "see a.html\n")
    before = (here / "a.html").read_text()
    assert "__VISER_EMBED_DATA__" in before
    assert_refused(call(capsys, "view", run, "--html", "a.html"), "choose another --html")
    assert call(capsys, "view", run, "--html", "a.html", "--force")[0] == 0
    (here / "a.html").write_text("a letter")
    assert_refused(call(capsys, "view", run, "--html", "a.html", "--force"))
    assert (here / "a.html").read_text() == "a letter"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["none"], "no such file"),
        (["."], "no such file"),
        (["n" * 3000], "ame too long"),
        (["run", "--html", "a.txt"], "a name that ends in .html"),
        (["run", "--html", "none/a.html"], "no folder none"),
        (["run", "--host", "no-such-host.invalid"], "no such address"),
    ],
)
def test_invalid_input_is_one_line(here, capsys, arguments, said):
    before = sorted(here.rglob("*"))
    assert_refused(call(capsys, "view", *arguments), said)
    assert sorted(here.rglob("*")) == before


def test_taken_port_is_one_line(here, capsys):
    with bind("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        assert_refused(call(capsys, "view", "run", "--port", port), f"--port: {port}: ", "another --port")


def test_missing_viser_is_one_line(here, capsys, monkeypatch):
    monkeypatch.setattr("skyherd.play.extras.find_spec", lambda name: None)
    assert_refused(call(capsys, "view", "run"), "skyherd view: viser is not installed")


def test_readable_part_of_a_damaged_recording_is_shown(here, capsys):
    path = here / "run" / "run.mcap"
    path.write_bytes(path.read_bytes()[:-2000])
    code, _, err = call(capsys, "view", "run", "--html", "a.html")
    assert code == 0 and "the readable part is shown" in err


def test_page_is_served_until_interrupted(here):
    command = [sys.executable, "-c", "from skyherd.cli import main; main()", "view", "run", "--port", "0"]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    ) as process:
        try:
            line = process.stdout.readline().strip()
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
    assert re.fullmatch(r"open http://127\.0\.0\.1:\d+/\?token=\S+", line)
    assert (process.returncode, out) == (130, "")
    assert err == "error: interrupted; the recording is as it was\n"
