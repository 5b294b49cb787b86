"""Errors of the command line: one line per problem, with the option that caused it."""

import pytest
from command_line import assert_refused, call

from skyherd.datasets import scenario_text
from skyherd.live.lab import lab_text


def test_each_problem_of_a_file_has_its_own_line(tmp_path, capsys):
    file = tmp_path / "mine.toml"
    text = scenario_text("star").replace("duration_s = ", "duration = ", 1)
    file.write_text(text.replace("[marker]", "[marker]\nside = 1", 1))
    code, out, err = call(capsys, "run", file)
    lines = err.splitlines()
    assert (code, out) == (2, "")
    assert lines[0] == f"error: {file}: duration: unknown key; did you mean 'duration_s'?"
    assert lines[1] == f"error: {file}: marker.side: unknown key; did you mean 'side_m'?"
    assert lines[2].startswith(f"error: {file}: duration_s: missing; ")
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["run", "star", "--perception", "psychic"],
            ["--perception: 'psychic'; one of rendered, ideal, noisy"],
        ),
        (["run", "star", "--seed", "-1"], ["error: --seed: -1; a whole number"]),
        (["play", "star", "--perception", "psychic"], ["--perception: 'psychic'; one of rendered"]),
        (["play", "star", "--speed", "0"], ["--speed"]),
        (["play", "star", "--speed", "nan"], ["--speed"]),
        (["play", "star", "--seed", "-1"], ["error: --seed: -1; a whole number"]),
        (["play", "star", "--host", "no-such-host.invalid"], ["no such address"]),
        (["dataset", "make", "small", "--images", "0"], ["error: --images: 0; a whole number from 1"]),
        (["detect", "a.png", "--dictionary", "DICT_9X9"], ["no dictionary 'DICT_9X9'"]),
    ],
)
def test_wrong_option_is_named_as_place(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(call(capsys, *arguments), *words)


def test_markers_and_detect_accept_names_of_opencv(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sheet = ["markers", "--ids", "0", "--side", "3cm", "--out", "a.pdf", "--dictionary"]
    assert call(capsys, *sheet, "DICT_APRILTAG_36h11")[0] == 0
    assert_refused(call(capsys, "detect", "a.pdf", "--dictionary", "DICT_4X4_50"), "a.pdf")


def test_report_names_the_verb_that_takes_a_configuration(capsys, tmp_path):
    (tmp_path / "star.toml").write_text(scenario_text("star"))
    (tmp_path / "lab.toml").write_text(lab_text("webcams"))
    refused = call(capsys, "report", tmp_path / "star.toml")
    assert_refused(refused, "is a scenario, not a run; give it to `skyherd run`")
    assert_refused(call(capsys, "topology", tmp_path / "lab.toml"), "is a lab, not a scenario")
    (tmp_path / "run.mcap").write_bytes(b"")
    assert_refused(
        call(capsys, "report", tmp_path / "run.mcap"), f"give its folder: `skyherd report {tmp_path}`"
    )


@pytest.mark.parametrize(
    ("verb", "wanted"),
    [
        (["detect"], "picture or video"),
        (["track"], "video"),
        (["dataset", "check"], "data set"),
        (["report"], "run"),
        (["export"], "run"),
    ],
)
def test_misplaced_scenario_or_recording_is_named(verb, wanted, capsys, tmp_path):
    (tmp_path / "star.toml").write_text(scenario_text("star"))
    (tmp_path / "x.mcap").write_bytes(b"\x89MCAP0\r\n")
    refused = call(capsys, *verb, tmp_path / "star.toml")
    assert_refused(refused, f"star.toml: is a scenario, not a {wanted}; give it to `skyherd run`")
    assert_refused(call(capsys, *verb, tmp_path / "x.mcap"), f"x.mcap: is a recording, not a {wanted}; ")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["scenario", "show", "webcams"],
            "'webcams': is a lab, not a scenario; give it to `skyherd live run`",
        ),
        (["live", "show", "noise"], "'noise': is a study, not a lab; give it to `skyherd study`"),
        (["dataset", "show", "grid"], "'grid': is a scenario, not a dataset spec; give it to `skyherd run`"),
        (
            ["study", "small", "--show"],
            "'small': is a dataset spec, not a study; give it to `skyherd dataset",
        ),
    ],
)
def test_built_in_name_of_another_kind_is_named(arguments, said, capsys):
    assert_refused(call(capsys, *arguments), said)
