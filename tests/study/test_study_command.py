"""Studies on the command line: rejected input, listing and display."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_line import assert_refused
from study_runs import SMALL, call

from skyherd.datasets import scenario_names


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            '"triangle"',
            '"triangel"',
            [
                "scenario 'triangel'",
                f"one of {', '.join(scenario_names())}",
            ],
        ),
        ('"V_end"', '"V_ned"', ["keep", "V_ned", "V_end"]),
        ("[0.1, 0.3]", "0.3", ["grid.control.k", "list", "0.3"]),
        ("[0.1, 0.3]", "[0.1, -3]", ["control.k=-3", "control.k: -3; a finite number from"]),
        ("control.k", "control.kk", ["control.kk", "unknown key"]),
        ("units.0", "units.4", ["units.4.yaw_deg", "0 to 0, or *"]),
        ("[set]", "[sett]", ["sett", "unknown key"]),
        ("duration_s = 0.4", "control.k = 1", ["control.k is given twice; each key once"]),
        ("0.4", "", ["malformed TOML"]),
    ],
)
def test_wrong_studies_are_rejected_in_one_line(
    old: str, new: str, words: list[str], write_study: Any, capsys: Any, tmp_path: Path
) -> None:
    path = write_study(SMALL.replace(old, new, 1))
    code, _, err = call(capsys, "study", path, "--out", tmp_path / "out")
    assert code == 2
    assert err.count("\n") == 1 and "Traceback" not in err
    for word in [str(path), *words]:
        assert word in err, err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nosuch"], "one of invariance, methods, noise"),
        (["noise", "--jobs", "0"], "--jobs: 0 is too small; a whole number from 1"),
        (["noise", "--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "one of them"),
        (["noise", "--scheduler", "nowhere"], "not an address"),
    ],
)
def test_wrong_arguments_are_rejected_in_one_line(
    arguments: list[str], words: str, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = call(capsys, "study", *arguments)
    assert code == 2
    assert words in err and err.count("\n") == 1


@pytest.mark.parametrize("options", [(), ("--dry-run",)])
@pytest.mark.parametrize("name", ["thesis.txt", "table.parquet"])
def test_foreign_folder_is_rejected_dry_or_not(
    write_study: Any, capsys: Any, tmp_path: Path, options: tuple[str, ...], name: str
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_text("mine")
    call_refused = call(capsys, "study", write_study(), *options, "--out", tmp_path / "out")
    assert_refused(call_refused, "is not the folder of a study; another --out: a new one, or that of a study")
    assert_refused(
        call(capsys, "study", write_study(), *options, "--out", tmp_path / "out" / name), "is a file"
    )


def test_dry_run_lists_runs_and_leaves_nothing(write_study: Any, capsys: Any, tmp_path: Path) -> None:
    code, said, _ = call(capsys, "study", write_study(), "--dry-run", "--out", tmp_path / "out")
    assert code == 0
    assert said.count("to do  control.k=") == 6
    assert "6 runs, 6 to do" in said
    assert not (tmp_path / "out").exists()


def test_built_in_studies_are_listed_and_shown(capsys: Any) -> None:
    assert "noise: " in call(capsys, "study")[1]
    assert "[grid]" in call(capsys, "study", "noise", "--show")[1]
    assert "keep" in json.loads(call(capsys, "study", "--schema")[1])["properties"]


def test_missing_extra_is_reported_in_one_line(tmp_path: Path) -> None:
    code = "import sys; sys.modules['distributed'] = None; from skyherd.cli import main; main()"
    command = [sys.executable, "-c", code, "study", "noise"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    said = "error: skyherd study: distributed is not installed; pip install 'skyherd[study]'\n"
    assert (ended.returncode, ended.stderr) == (2, said)
