"""`skyherd topology`, in process: output, files and refused input."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from skyherd.cli import main
from skyherd.datasets import scenario_text
from skyherd.recording.writer import McapRecorder


def call(capsys, *arguments) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return (caught.value.code or 0, *capsys.readouterr())


@pytest.fixture(scope="module")
def run(tmp_path_factory, ideal_failure) -> Path:
    """Return a recorded run of the mission `failure` until after unit 0's death, on exact points."""
    folder = tmp_path_factory.mktemp("run")
    mission, steps = ideal_failure
    with McapRecorder(folder / "run.mcap", mission, images=False) as recorder:
        for step in steps:
            recorder.write(step)
        recorder.finish(32.0, 1.0)
    return folder


def is_picture(path: Path) -> bool:
    with Image.open(path) as image:
        return min(image.size) > 300 and bool(np.ptp(np.asarray(image.convert("L"))) > 100)


def test_topology_shows_scenario_after_deployment(tmp_path, capsys, monkeypatch, ideal_failure) -> None:
    monkeypatch.chdir(tmp_path)
    code, said, _ = call(capsys, "topology", "failure")
    assert code == 0
    assert "VIOLATED" not in said
    ready_s = next(
        s.time_s for s in ideal_failure[1] if any(f.decision.report.tree.ready for f in s.frames.values())
    )
    for words in (f"failure at {ready_s:.1f} s", "slowest mode", "predicted"):
        assert words in said
    assert "measured" not in said
    assert is_picture(tmp_path / "failure-topology.png")


def test_topology_of_a_run_shows_deaths_and_measured_rate(run, capsys) -> None:
    code, said, _ = call(capsys, "topology", run)
    assert code == 0, "the heir has repaired the tree by then"
    for words in ("unit 0 died", "no unit → unit 1", "the tree is complete", "measured"):
        assert words in said
    assert is_picture(run / "topology.png")
    again = call(capsys, "topology", run / "run.mcap", "--out", run / "mine.svg")
    assert again[0] == 0
    assert again[1].replace("mine.svg", "topology.png") == said
    assert (run / "mine.svg").read_bytes().endswith(b"</svg>\n")


def test_free_overlaps_are_listed_and_not_required(tmp_path, capsys) -> None:
    code, said, _ = call(capsys, "topology", "star", "--out", tmp_path / "star.png")
    assert code == 0
    assert "VIOLATED" not in said and "sufficient, not required here" in said
    for words in ("units 0 and 1 share", "controlled by 3 units", "units on a cycle: 0, 1, 2"):
        assert words in said


def test_uncontrolled_robot_violates_a_required_condition(tmp_path, capsys) -> None:
    file = tmp_path / "far.toml"
    file.write_text(scenario_text("triangle").replace("height_m = 10.7", "height_m = 4.0"))
    code, said, _ = call(capsys, "topology", file, "--out", tmp_path / "far.png")
    assert code == 1
    assert "VIOLATED" in said and "controlled by no unit" in said


@pytest.mark.parametrize(
    ("source", "out", "said"),
    [
        ("no-such-name", "a.png", "one of chain"),
        ("absent.mcap", "a.png", "no such file"),
        (".", "a.png", "no run.mcap"),
        ("star", "a.txt", ".png or .svg"),
        ("star", "no/such/folder/a.png", "no folder no/such/folder"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, capsys, monkeypatch, source, out, said) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "topology", source, "--out", out)
    assert code == 2
    assert err.count("\n") == 1
    assert said in err
    assert list(tmp_path.iterdir()) == []
