"""Nightly run: it reports each failure, and only observed successes."""

import datetime
import json
import subprocess

import pytest

GOOD = {
    "missions": 4,
    "converged": 4,
    "inside_p_throughout": 4,
    "longest_violation_of_those_never_cut_s": 0.0,
    "missions_cut": 1,
    "min_gap_m": 0.1,
    "with_collisions": 0,
}


@pytest.fixture
def nightly(load_benchmark):
    return load_benchmark("nightly")


@pytest.mark.parametrize(
    ("changed", "wrong"),
    [
        ({}, set()),
        ({"converged": 3}, {"trees", "killed", "survivors", "crowds"}),
        ({"longest_violation_of_those_never_cut_s": 0.2}, {"trees"}),
        ({"with_collisions": 1}, {"crowds"}),
        ({"missions": 0, "converged": 0}, {"trees", "killed", "survivors", "crowds"}),
    ],
)
def test_each_mission_group_has_its_own_verdict(nightly, changed, wrong) -> None:
    """Robots may be uncontrolled for a while after a death; otherwise P always holds."""
    groups = {"trees", "killed", "survivors", "crowds"}
    assert {name for name in groups if not nightly.MISSIONS[name].is_right(GOOD | changed)} == wrong


@pytest.mark.parametrize(
    ("printed", "code", "right"), [(json.dumps(GOOD), 0, True), (json.dumps(GOOD), 1, False), ("", 0, False)]
)
def test_broken_or_silent_benchmark_fails(nightly, monkeypatch, printed, code, right) -> None:
    commands = []

    def run(command, **_):
        commands.append(command)
        return subprocess.CompletedProcess(command, code, stdout=printed)

    monkeypatch.setattr(nightly.subprocess, "run", run)
    outcome = nightly.run_missions("clocks", 0.1, 2, 7000)
    assert outcome.is_right == right
    assert commands[0][-6:] == ["--missions", "20", "--seed", "7000", "--jobs", "2"]


def test_page_has_row_for_each_step_and_shows_failures(nightly) -> None:
    outcomes = [
        nightly.Outcome("other slow tests", False, "1 failed | x", 90.0),
        nightly.Outcome("trees", True, "all", 60.0),
    ]
    assert nightly.as_page(outcomes, datetime.date(2026, 1, 2)).splitlines()[-2:] == [
        "| trees | 2026-01-02 | yes | 1.0 | all |",
        "| other slow tests | 2026-01-02 | **no** | 1.5 | 1 failed \\| x |",
    ]


def test_earlier_rows_stay_until_their_step_runs_again(nightly) -> None:
    def page(names, day, before=""):
        outcomes = [nightly.Outcome(name, True, f"on {day}", 60.0) for name in names]
        return nightly.as_page(outcomes, datetime.date(2026, 1, day), before)

    first = page(["trees", "other slow tests"], 2)
    rows = page(["crowds", "trees"], 3, first).splitlines()[-3:]
    assert [row.split(" | ")[:2] for row in rows] == [
        ["| trees", "2026-01-03"],
        ["| crowds", "2026-01-03"],
        ["| other slow tests", "2026-01-02"],
    ]
    assert page([], 4, first) == first


def test_every_slow_test_is_in_exactly_one_step(nightly) -> None:
    """A folder with its own step exists, and is excluded from the other steps."""
    steps = [arguments for arguments in nightly.TESTS.values() if "slow and not random" in arguments]
    folders = {f"tests/{part}" for part in nightly.SLOW_PARTS}
    assert sorted(arguments[2] for arguments in steps if len(arguments) == 3) == sorted(folders)
    (others,) = (arguments[2:] for arguments in steps if len(arguments) != 3)
    assert set(others) == {f"--ignore={folder}" for folder in folders}
    assert all((nightly.ROOT / folder).is_dir() for folder in folders)


def test_missions_of_two_days_share_no_seed(nightly) -> None:
    """The largest share is the whole published number, at most 1000."""
    assert max(missions.published for missions in nightly.MISSIONS.values()) <= 1000
