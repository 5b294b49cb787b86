"""Examples of docs/extending.md: each runs unchanged and has the documented effect."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from skyherd.datasets import load_mission
from skyherd.loop import run_steps
from skyherd.plots import panels
from skyherd.vision import create_detector

PAGE = Path(__file__).parents[1] / "docs" / "extending.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> dict:
    """Run the blocks of the page as one script in a new folder, and return the names that they define.

    `last_steps` has the last step of each mission that the script runs to its end.
    """
    folder = tmp_path_factory.mktemp("extending")
    names: dict = {"last_steps": []}
    text = PAGE.read_text("utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(panels, "PANELS", panels.PANELS[:1])
        patch.chdir(folder)
        for block in re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
            exec(compile(block, str(PAGE), "exec"), names)
            if "step" in names:
                names["last_steps"].append(names.pop("step"))
    return names | {"folder": folder / names["folder"]}


@pytest.fixture(scope="module")
def frame():
    """Return an image of the triangle's robots, and the ids of those that are whole in it."""
    mission = load_mission("triangle", ["duration_s=0.1"])
    sight = next(iter(run_steps(mission))).frames[0].sight
    return sight.image, sight.whole_ids.tolist()


def test_example_detector_equals_the_named_one(page, frame) -> None:
    image, whole_ids = frame
    ours = create_detector(dictionary="4X4_50").detect(image)
    plain = page["PlainOpenCV"]("4X4_50").detect(image, time_s=3.0, unit_id=2)
    assert sorted(plain.ids.tolist()) == sorted(ours.ids.tolist()) == sorted(whole_ids)
    assert (plain.time_s, plain.unit_id) == (3.0, 2)
    order, ours_order = np.argsort(plain.ids), np.argsort(ours.ids)
    assert np.abs(plain.centers_px[order] - ours.centers_px[ours_order]).max() < 1.0


def test_example_policy_and_flight_law_form_the_shape(page) -> None:
    step = page["last_steps"][0]
    assert step.metrics.shape.error < 0.05
    assert step.fleet.yaws_rad[0] > 1.0, "it turned all the while"


def test_example_robot_law_forms_the_shape(page) -> None:
    step = page["last_steps"][1]
    assert step.metrics.shape.error < 0.05


def test_example_unit_decides_nothing_in_fog(page) -> None:
    """It clears at 5 s; the control set changes at the next slot of two seconds."""
    assert page["first_goal_s"] == pytest.approx(6.0, abs=1e-9)


def test_example_recorder_has_one_row_a_step(page) -> None:
    with page["folder"].with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    times = [float(row["time_s"]) for row in rows]
    assert times == pytest.approx(np.arange(len(times)) * page["short"].scenario.step_s)
    assert times[-1] == pytest.approx(2.0)
    assert 0 < float(rows[-1]["shape_error"]) < float(rows[0]["shape_error"])
