"""A third recorder, written from the docstring of `Recorder` alone, and progress of a run."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

from skyherd import runner
from skyherd.datasets import load_mission
from skyherd.loop import Step
from skyherd.recording.reader import read_recording
from skyherd.runner import RECORDING, run_mission


class PathRecorder:
    """Recorder of the first robot's path as a text file."""

    def __init__(self, path: Path) -> None:
        self.path, self.times_s, self.ends = path, list[float](), list[type[BaseException] | None]()

    def __enter__(self) -> "PathRecorder":
        self._file = self.path.open("w")
        return self

    def write(self, step: Step) -> None:
        self.times_s.append(step.time_s)
        x_m, y_m = step.positions_m[0]
        self._file.write(f"{x_m} {y_m}\n")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.ends.append(kind)
        self._file.close()


class Reported:
    """Progress that keeps all reports."""

    def __init__(self) -> None:
        self.calls: list[tuple[str, float, float | None, str | None]] = []

    def update(self, name: str, done: float, total: float | None, state: str | None = None) -> None:
        self.calls.append((name, done, total, state))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Run half a second of a mission, without figures and page."""
    monkeypatch.setattr(runner, "make_report", lambda folder, film: {"folder": folder})
    monkeypatch.setattr(runner, "write_figures", lambda history, folder, jobs: [])
    mission = load_mission("triangle", ["perception=ideal", "duration_s=0.5"])
    return lambda **options: run_mission(mission, tmp_path / "run", video=False, **options)


def test_user_recorder_gets_every_step_once_in_order(run: Callable[..., Any], tmp_path: Path) -> None:
    recorder, reported = PathRecorder(tmp_path / "path.txt"), Reported()
    run(recorders=[recorder], progress=reported)
    recording = read_recording(tmp_path / "run" / RECORDING)
    assert recorder.times_s == pytest.approx([step.time_s for step in recording.steps])
    assert recorder.times_s == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert recorder.ends == [None]
    assert len((tmp_path / "path.txt").read_text().splitlines()) == 6
    assert [call[1] for call in reported.calls] == recorder.times_s
    assert {call[0] for call in reported.calls} == {"triangle"} and {call[2] for call in reported.calls} == {
        0.5
    }
    assert "found 6/6" in str(reported.calls[0][3]) and "drawing" in str(reported.calls[-1][3])


def test_recorder_is_closed_on_interrupt(run: Callable[..., Any], tmp_path: Path) -> None:
    def interrupt(step: Step) -> None:
        if step.time_s > 0.15:
            raise KeyboardInterrupt

    recorder = PathRecorder(tmp_path / "path.txt")
    with pytest.raises(KeyboardInterrupt):
        run(recorders=[recorder], on_step=interrupt)
    assert recorder.ends == [KeyboardInterrupt]
    assert len(recorder.times_s) == 3
    recording = read_recording(tmp_path / "run" / RECORDING)
    assert (len(recording.steps), recording.wall_s) == (3, None)
