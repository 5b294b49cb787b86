"""Ctrl-C and SIGTERM: one line, removal of partial output, and the exit code of the signal."""

import os
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest
from command_line import call

from skyherd.cli.interrupts import CODES, SignalReceived, describe, signals_as_interrupts
from skyherd.recording.reader import read_recording
from skyherd.recording.writer import McapRecorder

SKYHERD = [sys.executable, "-c", "from skyherd.cli import main; main()"]


def raising(error):
    def fail(*arguments, **options):
        raise error

    return fail


@pytest.mark.parametrize("name", CODES)
def test_signal_becomes_interrupt_and_handlers_are_restored(name):
    number = getattr(signal, name)
    before = signal.getsignal(number)
    with pytest.raises(SignalReceived) as received, signals_as_interrupts():
        signal.raise_signal(number)
        time.sleep(10)
    assert received.value.args == (name,)
    assert describe(received.value) == (
        ("interrupted" if name == "SIGINT" else f"ended by {name}") + "; nothing is left of it",
        128 + number,
    )
    assert signal.getsignal(number) is before


def test_ignored_signal_stays_ignored():
    """As under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with signals_as_interrupts():
            signal.raise_signal(signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(
    ("verb", "target", "said"),
    [
        (["scenario", "check", "star"], "skyherd.datasets.load_mission", "nothing is left of it"),
        (["run", "star"], "skyherd.runner.run_mission", "nothing is left of it"),
        (["detect", "a.png"], "skyherd.inspection.Inspector.inspect", "nothing is left of it"),
        (["dataset", "make", "small"], "skyherd.datasets.labelled.make.make_dataset", "continues from here"),
        (["study", "noise", "--quick"], "skyherd.study.conduct.conduct", "continues from here"),
        (["bench", "detectors"], "skyherd.bench.execution.measure_cells", "nothing is left of it"),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_interrupted_verb_names_remaining_files_in_one_line(
    tmp_path, monkeypatch, capsys, verb, target, said
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(target, raising(KeyboardInterrupt()))
    code, _, err = call(capsys, *verb)
    assert (code, err.count("\n")) == (130, 1)
    assert err.startswith("error: interrupted; ") and said in err
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(target, raising(SignalReceived("SIGTERM")))
    code, _, err = call(capsys, *verb)
    assert (code, err.count("\n")) == (143, 1)
    assert err.startswith("error: ended by SIGTERM; ")


def test_interrupted_run_leaves_recording_and_no_part_files(tmp_path, monkeypatch, capsys):
    write, steps = McapRecorder.write, []

    def stop(self, step):
        steps.append(step)
        if len(steps) == 4:
            raise KeyboardInterrupt
        write(self, step)

    monkeypatch.setattr(McapRecorder, "write", stop)
    out = tmp_path / "out"
    code, _, err = call(capsys, "run", "triangle", "--out", out, "--perception", "ideal")
    assert (code, err) == (
        130,
        f"error: interrupted; the recorded part can be shown by `skyherd report {out}`\n",
    )
    assert sorted(path.name for path in out.iterdir()) == [".skyherd.json", "run.mcap"]
    assert len(read_recording(out / "run.mcap").steps) == 3


def test_run_interrupted_before_first_step_leaves_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(McapRecorder, "write", raising(KeyboardInterrupt()))
    code, _, err = call(capsys, "run", "triangle", "--out", tmp_path / "out", "--perception", "ideal")
    assert (code, err) == (130, "error: interrupted; nothing is left of it\n")
    assert not list(tmp_path.iterdir())


def test_sigterm_of_another_process_removes_partial_output(tmp_path):
    """The signal ends a video of 8000 frames before its last frame, also on a slow machine."""
    size = (320, 240)
    writer = cv2.VideoWriter(str(tmp_path / "v.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25, size)
    for _ in range(8000):
        writer.write(np.full((240, 320, 3), 90, np.uint8))
    writer.release()
    process = subprocess.Popen(
        [*SKYHERD, "detect", "v.avi", "--explain"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    ends = time.monotonic() + 300
    while not list(tmp_path.glob("detections/v/.skyherd-*.part")) and time.monotonic() < ends:
        assert process.poll() is None
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGTERM)
    _, err = process.communicate(timeout=300)
    assert (process.returncode, err) == (143, "error: ended by SIGTERM; nothing is left of it\n")
    assert [path.name for path in tmp_path.iterdir()] == ["v.avi"]
