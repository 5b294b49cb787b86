"""Public functions with invalid arguments: one line names the argument and the allowed values."""

import pytest

import skyherd
from skyherd.errors import InputError
from skyherd.plots import panels

CALLS = {
    "load_mission(None)": (lambda path: skyherd.load_mission(None), "name_or_file: None"),
    "settings as a text": (
        lambda path: skyherd.load_mission("triangle", "seed=1"),
        "settings: 'seed=1'; a list",
    ),
    "settings None": (lambda path: skyherd.load_mission("triangle", None), "settings: None; a list of texts"),
    "a setting of 3": (lambda path: skyherd.load_mission("triangle", [3]), "settings: 3; a text"),
    "read_recording(None)": (lambda path: skyherd.read_recording(None), "path: None; a path"),
    "read_dataset(None)": (lambda path: skyherd.read_dataset(None), "path: None; a path"),
    "create_detector(None)": (lambda path: skyherd.create_detector(None), "create_detector: None; a text"),
    "dictionary=3": (lambda path: skyherd.create_detector(dictionary=3), "create_detector: 3; a text"),
    "shape_points(None)": (lambda path: skyherd.shape_points(None, 4), "template.shape: None; a text"),
    "run_steps(text)": (lambda path: next(skyherd.run_steps("triangle")), "mission: 'triangle'; a Mission"),
    "run_mission(text)": (
        lambda path: skyherd.run_mission("triangle", path),
        "mission: 'triangle'; a Mission",
    ),
    "folder None": (lambda path: run(None), "folder: None; a path"),
    "jobs 0": (lambda path: run(path, jobs=0), "jobs: 0; a whole number from 1"),
    "jobs -3": (lambda path: run(path, jobs=-3), "jobs: -3; a whole number from 1"),
    "force x": (lambda path: run(path, force="x"), "run_mission: force: 'x'; True or False"),
    "jobs x": (lambda path: run(path, jobs="x"), "jobs: 'x'; a whole number from 1"),
}
"""Calls of the library with an invalid argument, and the expected words of the error."""


def run(folder, **options):
    mission = skyherd.load_mission("triangle", (text for text in ("perception=ideal", "duration_s=0.2")))
    return skyherd.run_mission(mission, folder, video=False, **options)


@pytest.mark.parametrize("call", CALLS)
def test_invalid_argument_is_refused_in_one_line(call, tmp_path) -> None:
    attempt, words = CALLS[call]
    with pytest.raises(InputError) as refused:
        attempt(tmp_path / "run")
    assert words in str(refused.value) and "\n" not in str(refused.value)
    assert list(tmp_path.iterdir()) == []


def test_mission_runs_into_folder_given_as_text(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(panels, "PANELS", panels.PANELS[1:2])
    assert run(str(tmp_path / "run"))["steps"] > 0 and (tmp_path / "run" / "run.mcap").is_file()
