"""A killed run loses at most half a second of simulated time, and reports the rest."""

import io
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from skyherd.cli import main
from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.recording.mcap_log import FLUSH_S
from skyherd.recording.survey import survey
from skyherd.recording.writer import McapRecorder

STEP_S = 0.1
"""Time step of the runs."""

RUN = """
import sys
from pathlib import Path
from skyherd.datasets import load_mission
from skyherd.runner import run_mission
mission = load_mission("triangle", ["perception=ideal", "duration_s=36000.0"])
with open(sys.argv[2], "w", buffering=1) as clock:
    print("begun", file=clock)
    run_mission(mission, Path(sys.argv[1]), video=False, on_step=lambda step: print(step.time_s, file=clock))
"""
"""Program of a run that writes the time of each step into a file, and lasts until it is killed."""


def killed_after(folder, clock, wait_s):
    """Kill a run after some time, and return the simulated time that it reached; None for none."""
    clock.write_text("")
    run = subprocess.Popen([sys.executable, "-c", RUN, str(folder), str(clock)], stderr=subprocess.DEVNULL)
    try:
        while run.poll() is None and not clock.read_text():
            time.sleep(0.002)
        time.sleep(wait_s)
    finally:
        os.kill(run.pid, signal.SIGKILL)
        run.wait()
    lines = clock.read_text().splitlines()[1:]
    return float(lines[-1]) if lines else None


def check_killed(tmp_path, wait_s, capsys, monkeypatch):
    monkeypatch.setattr("skyherd.runner.write_figures", lambda history, folder, jobs: [])
    folder, clock = tmp_path / "run", tmp_path / "clock.txt"
    reached_s = killed_after(folder, clock, wait_s)
    monkeypatch.setattr(sys, "argv", ["skyherd", "report", str(folder)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    if ended.value.code == 0:
        read_s = float(re.search(r"cut short: after ([\d.]+) s", said)[1])
        assert reached_s is None or reached_s - read_s <= FLUSH_S + STEP_S / 100
    else:
        # Nothing was recorded: no folder yet, or a file without a step.
        assert (ended.value.code, reached_s) == (2, None)
        assert len(said.splitlines()) == 1 and "Traceback" not in said


def test_killed_run_loses_at_most_half_a_second(tmp_path, capsys, monkeypatch):
    check_killed(tmp_path, 0.15, capsys, monkeypatch)


def test_run_killed_after_first_step_has_report(tmp_path, monkeypatch):
    """The report is complete, with its figures."""
    monkeypatch.setattr(sys, "argv", ["skyherd", "report", str(tmp_path)])
    mission = load_mission("triangle", ["perception=ideal"])
    with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
        recorder.write(next(run_steps(mission)))
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code == 0
    assert (tmp_path / "report.html").is_file()


@pytest.mark.parametrize("step_s", [0.04, 0.1, 0.3, 1.0])
def test_file_lags_at_most_half_a_second_at_any_step(tmp_path, step_s):
    """SIGKILL leaves the data given to the operating system: they are read after each step."""
    path, rate_hz = tmp_path / "run.mcap", min(10.0, 1 / step_s)
    settings = [f"step_s={step_s}", f"units.*.frame_rate_hz={rate_hz}", "duration_s=3.0"]
    mission = load_mission("triangle", ["perception=ideal", *settings])
    with McapRecorder(path, mission) as recorder:
        found = survey(io.BytesIO(path.read_bytes()))
        assert [chunk.after for chunk in found.chunks] == [1, 2]  # the mission, twice
        for step in run_steps(mission):
            recorder.write(step)
            read_s = survey(io.BytesIO(path.read_bytes())).chunks[-1].last_s
            assert step.time_s - read_s <= FLUSH_S + TIME_TOLERANCE_S


@pytest.mark.slow
@pytest.mark.parametrize("number", range(50))
def test_50_runs_killed_at_random_times(tmp_path, number, capsys, monkeypatch):
    check_killed(tmp_path, np.random.default_rng([22, number]).exponential(0.5), capsys, monkeypatch)
