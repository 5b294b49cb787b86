"""Command line, in process: files, refused input and exit codes."""

import errno
import json
import os
import signal
import subprocess
import sys
import time

import pytest
from command_line import assert_refused, call

from skyherd import runner
from skyherd.datasets import scenario_text
from skyherd.plots import panels
from skyherd.plots.panels import PANELS
from skyherd.recording.writer import McapRecorder

SHORT = ["--perception", "ideal", "--no-video", "--set", "duration_s=1.0"]


@pytest.fixture(autouse=True)
def few_figures(monkeypatch):
    """Limit runs to one figure, since drawing all takes longer than the run; tests/plots checks all."""
    monkeypatch.setattr(panels, "PANELS", PANELS[1:2])


SUMMARY_KEYS = [
    "scenario",
    "seed",
    "perception",
    "converged",
    "simulated_s",
    "real_time_factor",
    "wall_s",
    "steps",
    "loop_steps_per_s",
    "frames",
    "frames_per_s",
    "shape_error",
    "scale",
    "rotation_rad",
    "V_start",
    "V_end",
    "detection_recall",
    "false_detections",
    "topology_changes",
    "tc1_violation_s",
    "tc2_violation_s",
    "tc3_violation_s",
    "tc4_violation_s",
    "tc5_violation_s",
    "min_separation_m",
    "min_gap_m",
    "collisions",
    "role_exchanges",
    "shortest_path_m",
    "path_length_m",
    "final_positions_m",
]


@pytest.mark.parametrize("figures", [2, pytest.param(len(PANELS), marks=pytest.mark.slow)])
def test_run_writes_all_documented_files(tmp_path, capsys, monkeypatch, figures):
    monkeypatch.setattr(panels, "PANELS", PANELS[:figures])
    out = tmp_path / "run"
    code, said, _ = call(
        capsys, "run", "star", "--out", out, "--perception", "ideal", "--set", "duration_s=1.0"
    )
    assert code == 1  # One second is too short to reach the shape.
    assert "Shape not reached, error" in said
    assert {entry.name for entry in out.iterdir()} == {
        ".skyherd.json", "run.mcap", "video.mp4", "video-phone.mp4", "figures", "summary.json", "report.html",
    }  # fmt: skip
    assert len(list((out / "figures").iterdir())) == 2 * figures
    assert (out / "report.html").read_text().count("<img") == figures
    summary = json.loads((out / "summary.json").read_text())
    assert set(SUMMARY_KEYS) <= set(summary)
    assert sorted(summary["final_positions_m"], key=int) == [str(robot) for robot in range(16)]
    assert summary["steps"] == 11


@pytest.mark.smoke
def test_reached_shape_has_exit_code_0(tmp_path, capsys):
    """The goal's tolerance includes the start."""
    wide = ["--set", "goal.shape_error=9", "--set", "goal.hold_s=0.5"]
    code, said, _ = call(capsys, "run", "triangle", "--out", tmp_path / "run", *SHORT, *wide)
    assert code == 0
    assert "Shape reached after 0 s" in said


def test_report_reproduces_the_summary(tmp_path, capsys):
    out = tmp_path / "run"
    call(capsys, "run", "star", "--out", out, *SHORT)
    first = (out / "summary.json").read_text()
    for name in ("summary.json", "report.html"):
        (out / name).unlink()
    assert call(capsys, "report", out)[0] == 0
    assert (out / "summary.json").read_text() == first
    assert (out / "report.html").read_text().count("<img") == 1


def test_unwritable_report_suggests_options_of_its_verb(tmp_path, capsys):
    out = tmp_path / "run"
    call(capsys, "run", "star", "--out", out, *SHORT)
    (out / "report.html").write_text("mine")
    refused = call(capsys, "report", out)
    assert_refused(refused, "report.html: was changed since skyherd made it; move it away\n")


def test_report_refuses_folder_without_run(tmp_path, capsys):
    (tmp_path / "a.txt").write_text("mine")
    (tmp_path / "empty").mkdir()
    for name, words in (("none", "no such folder"), ("a.txt", "is a file"), ("empty", "no run.mcap in it")):
        assert_refused(call(capsys, "report", tmp_path / name), f"{name}: {words}")


@pytest.mark.parametrize("verb", [("scenario", "check"), ("live", "check"), ("dataset", "make"), ("study",)])
def test_folder_instead_of_a_file_is_named(verb, tmp_path, capsys):
    refused = call(capsys, *verb, tmp_path)
    assert_refused(refused, f"'{tmp_path}': is a folder; a TOML file or one of ")


@pytest.mark.parametrize("arguments", [["detect", ""], ["detect", "a.png", "--out", ""], ["track", "--out="]])
def test_empty_argument_is_refused(arguments, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(call(capsys, *arguments), "is empty; give a name or a value")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "path"),
    [
        (["track", "--no"], "skyherd track"),
        (["dataset", "make", "--no"], "skyherd dataset make"),
        (["--no"], "skyherd"),
    ],
)
def test_wrong_option_names_help_of_its_verb(arguments, path, capsys):
    assert_refused(call(capsys, *arguments), f" see `{path} --help`\n")


def test_report_makes_video_from_recorded_images(tmp_path, capsys):
    out = tmp_path / "run"
    call(capsys, "run", "triangle", "--out", out, "--set", "duration_s=0.5", "--no-video", "--record-images")
    assert not (out / "video.mp4").exists()
    code, _, err = call(capsys, "report", out)
    assert (code, err) == (0, "")
    assert (out / "video.mp4").stat().st_size > 10_000


def test_existing_folder_is_refused_without_force(tmp_path, capsys):
    out = tmp_path / "run"
    out.mkdir()
    assert_refused(call(capsys, "run", "star", "--out", out, *SHORT), str(out), "--force")
    (out / "mine.txt").write_text("precious")
    (out / "figures").mkdir()
    (out / "figures" / "thesis.txt").write_text("precious")
    assert_refused(call(capsys, "run", "star", "--out", out, *SHORT), str(out), "--force")
    assert {entry.name for entry in out.iterdir()} == {"mine.txt", "figures"}
    call(capsys, "run", "star", "--out", out, "--force", *SHORT)
    assert (out / "mine.txt").read_text() == (out / "figures" / "thesis.txt").read_text() == "precious"
    assert (out / "report.html").exists()


def test_impossible_output_folder_is_refused(tmp_path, capsys):
    file = tmp_path / "file"
    file.write_text("")
    assert_refused(call(capsys, "run", "star", "--out", file, *SHORT), str(file), "is a file")
    assert_refused(call(capsys, "run", "star", "--out", file / "below", *SHORT), "file/below")


def test_full_disk_is_refused_before_the_run(tmp_path, capsys, monkeypatch):
    usage = runner.shutil.disk_usage(tmp_path)
    monkeypatch.setattr(runner.shutil, "disk_usage", lambda path: usage._replace(free=5 * 2**20))
    out = tmp_path / "run"
    assert_refused(call(capsys, "run", "star", "--out", out, *SHORT), "5 MiB free", "100 MiB")
    assert not out.exists()


def test_disk_that_fills_up_during_run_is_one_line(tmp_path, capsys, monkeypatch):
    def full(self, step):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(McapRecorder, "write", full)
    out = tmp_path / "run"
    assert_refused(
        call(capsys, "run", "star", "--out", out, "--perception", "ideal", "--set", "duration_s=1.0"),
        f"{out}: No space left",
    )
    assert not out.exists()  # No step was recorded.


@pytest.mark.usefixtures("few_figures")
def test_disk_that_fills_up_later_leaves_the_recording(tmp_path, capsys, monkeypatch):
    write, steps = McapRecorder.write, []

    def full(self, step):
        steps.append(step)
        if len(steps) == 5:
            raise OSError(errno.ENOSPC, "No space left on device", "run.mcap")
        write(self, step)

    monkeypatch.setattr(McapRecorder, "write", full)
    out = tmp_path / "run"
    assert_refused(call(capsys, "run", "star", "--out", out, *SHORT), "No space left")
    assert {entry.name for entry in out.iterdir()} == {".skyherd.json", "run.mcap"}
    assert call(capsys, "report", out)[0] == 0
    assert json.loads((out / "summary.json").read_text())["steps"] == 4


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "no-such-scenario"], ["no-such-scenario", "star"]),
        (["run", "star", "--perception", "psychic"], ["perception", "psychic", "rendered"]),
        (["run", "star", "--seed", "many"], ["--seed", "whole number"]),
        (["run", "star", "--set", "marker.side_m=nan"], ["marker.side_m", "finite"]),
        (["run", "star", "--set", 'description="\udcff"'], [r'description="\xff"', "UTF-8"]),
        (["scenario", "check", "star", "--set", "\udcff=1"], [r"\xff", "UTF-8"]),
        (["live", "check", "webcams", "--set", "team=\udcff"], [r"\xff", "UTF-8"]),
        (
            ["scenario", "check", "star", "--set", "units.0.camera.preset=[1]"],
            ["camera.preset", "a text in quotes"],
        ),
        (
            ["scenario", "check", "star", "--set", "units.0.camera.preset={}"],
            ["camera.preset", "a text in quotes"],
        ),
        (["run", "star", "--colour"], ["--colour"]),
        (["run"], ["SCENARIO", "missing"]),
        (["report", "no-such-folder"], ["no-such-folder", "no such folder"]),
        (["scenario", "show", "nothing"], ["nothing", "star"]),
        (["scenario", "check", "nothing.toml"], ["nothing.toml"]),
    ],
)
def test_bad_arguments_are_one_line(tmp_path, capsys, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert_refused(call(capsys, *arguments), *words)
    assert not list(tmp_path.iterdir())


def test_mirrored_stream_is_named_and_leaves_nothing(tmp_path, capsys):
    out, mirrored = tmp_path / "run", ["--set", "units.0.camera.mirrored=true"]
    assert_refused(call(capsys, "run", "triangle", "--out", out, *mirrored), "unit 0", "mirrored", "flip")
    assert not out.exists()
    call(capsys, "run", "triangle", "--out", out, *SHORT)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert_refused(call(capsys, "run", "triangle", "--force", "--out", out, *mirrored), "mirrored")
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_mirrored_stream_without_first_frame_is_named_at_next(tmp_path, capsys):
    settings = ["units.0.camera.mirrored=true", "network.frame_loss=0.7", "duration_s=3.0"]
    flags = [part for setting in settings for part in ("--set", setting)]
    assert_refused(call(capsys, "run", "triangle", "--out", tmp_path / "run", *flags), "mirrored")


def test_camera_without_robots_gets_a_warning(tmp_path, capsys):
    code, _, err = call(
        capsys, "run", "star", "--out", tmp_path / "run", *SHORT, "--set", "units.2.position_m=[200, 0]"
    )
    assert code == 1
    assert "warning: unit 2 sees no robot" in err


def test_goals_stale_between_two_images_get_a_warning(tmp_path, capsys):
    slow = ["--set", "units.1.frame_rate_hz=1"]
    assert (
        "warning: unit 1 takes images less often than robots.timeout_s"
        in call(capsys, "run", "star", "--out", tmp_path / "run", *SHORT, *slow)[2]
    )


def test_scenario_verbs_list_show_and_check(capsys):
    code, listed, _ = call(capsys, "scenario", "list")
    assert code == 0
    assert all(name in listed for name in ("triangle", "star", "grid", "circle"))
    assert call(capsys, "scenario", "show", "star")[1] == scenario_text("star")
    assert "16 robots, 3 units" in call(capsys, "scenario", "check", "star")[1]
    assert json.loads(call(capsys, "scenario", "schema")[1])["title"] == "Scenario"


def test_killed_run_still_has_figures(tmp_path, capsys):
    out = tmp_path / "run"
    command = [sys.executable, "-c", "from skyherd.cli import main; main()", "run", "star", "--out", str(out)]
    command += ["--perception", "ideal"]
    run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    recording, deadline = out / "run.mcap", time.monotonic() + 600
    while time.monotonic() < deadline and not (recording.exists() and recording.stat().st_size > 100_000):
        time.sleep(0.05)
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    assert not (out / "video.mp4").exists()  # No partial video remains.
    code, _, err = call(capsys, "report", out)
    assert code == 0
    assert "cut short" in err
    summary = json.loads((out / "summary.json").read_text())
    assert not summary["complete"]
    assert 0 < summary["simulated_s"] < 100
    assert len(list((out / "figures").glob("*.png"))) == 1


def test_interrupt_during_loading_ends_program():
    # An import finder raises the user's Ctrl-C while skyherd.cli is imported.
    interrupt = """
import runpy, sys
class Interrupt:
    def find_spec(self, name, *rest):
        if name == "skyherd.cli":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
runpy.run_module("skyherd", run_name="__main__")
"""
    ended = subprocess.run([sys.executable, "-c", interrupt], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "interrupted\n")


def test_package_runs_as_a_program():
    command = [sys.executable, "-m", "skyherd", "--version"]
    assert subprocess.check_output(command, text=True).startswith("skyherd ")
