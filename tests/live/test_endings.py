"""Interrupted runs of real processes: any signals at any time lead to the same state."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from live_processes import PATIENCE_S, free_port, wait_for
from PIL import Image

SKYHERD = [sys.executable, "-m", "skyherd"]

LAB = """
team = "endings"
shape.shape = "circle"
markers.side_m = 0.1
cameras = [{{ address = "{images}" }}]
robots = [{{ id = 0 }}, {{ id = 1 }}]
radio.listen = ["{place}"]
radio.connect = ["{place}"]
"""


@pytest.fixture
def lab_file(tmp_path) -> Path:
    """Return a lab whose camera is a folder of images, so that it needs no other processes."""
    images = tmp_path / "images"
    images.mkdir()
    Image.fromarray(np.full((120, 160), 90, np.uint8)).save(images / "0.png")
    path = tmp_path / "lab.toml"
    path.write_text(LAB.format(images=images, place=f"tcp/127.0.0.1:{free_port()}"), encoding="utf-8")
    return path


def processes_of(lab_file: Path) -> dict[int, str]:
    """Return the command lines of the processes of a lab, by process id."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if str(lab_file) in words:
            found[int(path.parent.name)] = " ".join(words)
    return found


def start(lab_file: Path, folder: Path) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [*SKYHERD, "live", "run", str(lab_file), "--out", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signals", "pause_s", "code"),
    [
        (["SIGINT", "SIGINT"], 0.05, 130),
        (["SIGINT", "SIGINT", "SIGINT"], 0.2, 130),
        (["SIGINT", "SIGINT"], 0.6, 130),
        (["SIGINT", "SIGTERM"], 1.5, 130),
        (["SIGTERM"], 0.0, 143),
        (["SIGTERM", "SIGINT"], 0.3, 143),
    ],
)
def test_run_ends_in_the_same_state_after_any_signals(lab_file, tmp_path, signals, pause_s, code) -> None:
    pytest.importorskip("zenoh")
    run = tmp_path / "run"
    session = start(lab_file, run)
    try:
        log = run / "live.log"
        wait_for(lambda: log.exists() and log.read_text().count("robot/") >= 2, "both robots")
        suspended = next(pid for pid, words in processes_of(lab_file).items() if " robot " in words)
        if pause_s == 0.05:
            os.kill(suspended, signal.SIGSTOP)
        for name in signals:
            session.send_signal(getattr(signal, name))
            time.sleep(pause_s)
        said, _ = session.communicate(timeout=PATIENCE_S)
        assert session.returncode == code
        assert not processes_of(lab_file), said
        assert "recorded in" in said and "still running" not in said and "Traceback" not in said
    finally:
        session.kill()
        for process in processes_of(lab_file):
            os.kill(process, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize(("verb", "number"), [("robot", "0"), ("unit", "0")])
def test_single_process_exits_with_the_code_of_its_signal(lab_file, tmp_path, verb, number) -> None:
    pytest.importorskip("zenoh")
    folder = tmp_path / "run"
    command = [*SKYHERD, verb, str(lab_file), number, "--out", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    wait_for(lambda: list(folder.glob("*.mcap")), "a log")
    process.send_signal(signal.SIGTERM)
    time.sleep(0.3)  # Python handles pending signals by number, not in their order of arrival.
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 143 and "Traceback" not in said
