"""Lines of the shape in the video, the view of the ground, and the end of the video."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skyherd.analysis.goal_points import (
    desired_points_px,
    outline_px,
    rectified_goals_px,
    rectified_outline_px,
)
from skyherd.datasets import load_mission, make_mission, scenario_names
from skyherd.datasets.shapes.shapes import SHAPES, shape_outline, shape_points
from skyherd.drawing.palette import TEMPLATE_COLOR, rgb
from skyherd.errors import InputError
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.video.ground_panel import MARGIN, GroundPanel
from skyherd.video.recorder import _Ending
from skyherd.video.rectified_panel import RectifiedPanel

ROUNDING = 1e-3
"""Distance of a robot from its line, template units: a circle drawn as a polygon is off by 3.4e-4."""


def distance(point: np.ndarray, line: np.ndarray) -> float:
    """Return the distance of a point (2,) to a polyline (M, 2)."""
    starts, ways = line[:-1], np.diff(line, axis=0)
    along = ((point - starts) * ways).sum(axis=1) / (ways**2).sum(axis=1)
    nearest = starts + along.clip(0, 1)[:, None] * ways
    return float(np.linalg.norm(point - nearest, axis=1).min())


@pytest.mark.parametrize("name", [*SHAPES, "word:SKY", "word:HERD"])
def test_each_robot_stands_on_a_line(name: str) -> None:
    count = 42
    lines = shape_outline(name, count)
    for point in shape_points(name, count):
        assert min(distance(point, line) for line in lines) < ROUNDING


def test_lines_of_word_stay_within_letters() -> None:
    """A space of 0.42 heights separates letters; a line across it would be wider than a letter."""
    lines = shape_outline("word:HI", 20)
    letter_h = [line for line in lines if line[:, 0].max() < 0.75]
    letter_i = [line for line in lines if line[:, 0].min() > 1.0]
    assert letter_h and letter_i and len(letter_h) + len(letter_i) == len(lines)


@pytest.mark.parametrize("name", scenario_names())
def test_built_in_scenario_has_lines(name: str) -> None:
    mission = load_mission(name)
    assert all(mission.outlines)


@pytest.fixture(scope="module")
def star():
    mission = load_mission("star", ["perception=ideal", "duration_s=12"])
    return mission, list(run_steps(mission))


def test_camera_lines_meet_desired_points(star) -> None:
    mission, steps = star
    frame = steps[-1].frames[0]
    lines = outline_px(frame.decision, mission.template, mission.outline_at(12.0))
    (line,) = lines
    (order,) = mission.scenario.template.outline
    desired = dict(zip(frame.decision.goals.ids.tolist(), desired_points_px(frame.decision), strict=True))
    offsets = [np.linalg.norm(line[order.index(robot)] - point) for robot, point in desired.items()]
    assert len(offsets) >= 5 and max(offsets) < 1e-6


def test_rectified_panel_shows_the_lines() -> None:
    """The handheld camera's image has bent lines; the rectified one has those of the template."""
    mission = load_mission("handheld", ["perception=ideal", "duration_s=1"])
    (*_, step) = run_steps(mission)
    frame, shape = step.frames[0], mission.shape_at(1.0, step.roles)
    lines = rectified_outline_px(frame.decision, shape, mission.outline_at(1.0))
    (order,) = mission.scenario.template.outline
    wanted = dict(zip(frame.decision.goals.ids.tolist(), rectified_goals_px(frame.decision), strict=True))
    offsets = [np.linalg.norm(lines[0][order.index(robot)] - point) for robot, point in wanted.items()]
    assert len(offsets) >= 5 and max(offsets) < 1e-6
    cells = np.zeros((2, 400, 500, 3), np.uint8)
    panel = RectifiedPanel(0, cells[0], (800, 600))
    panel.draw(frame, lines)
    RectifiedPanel(0, cells[1], (800, 600)).draw(frame)
    purple = (np.abs(cells.astype(int) - rgb(TEMPLATE_COLOR)).max(axis=3) < 60).sum(axis=(1, 2))
    assert purple[0] > purple[1] + 200


def test_view_without_goals_has_no_lines(star) -> None:
    mission, steps = star
    decision = replace(steps[-1].frames[0].decision, goals=None)
    assert outline_px(decision, mission.template, mission.outline_at(12.0)) == []


def test_ground_view_frames_robots(star) -> None:
    """Robots stay inside half the margin, and fill more than half of the map's height."""
    mission, steps = star
    view = GroundPanel(mission, np.zeros((700, 800, 3), np.uint8))
    height, width = view._field.shape[:2]
    for step in steps:
        view.draw(step)
        places = view.to_panel(step.positions_m)
        low, high = places.min(axis=0), places.max(axis=0)
        assert (low > 0).all() and (high < (width, height)).all()
    assert ((high - low) / (width, height)).max() > (1 - 2 * MARGIN) / 1.5


def test_ground_view_shows_lines(star) -> None:
    """Between neighbours of the outline, all of the line has the shape's colour, or is under a mark."""
    mission, steps = star
    view = GroundPanel(mission, np.zeros((700, 800, 3), np.uint8))
    for step in steps:
        view.draw(step)
    (line,) = (view.to_panel(points) for points in view._shape_m(steps[-1])[1:])
    middles = np.rint((line[:-1] + line[1:]) / 2).astype(int)
    near = np.abs(view._field[middles[:, 1], middles[:, 0]].astype(int) - rgb(TEMPLATE_COLOR)).max(axis=1)
    assert (near < 40).mean() > 0.7


def shown(mission, errors: dict[float, float]) -> list[float]:
    """Return the times, s, of 40 s that the video shows; errors change at the given times."""
    ending, times = _Ending(mission), []
    for time_s in np.arange(0.0, 40.0, 0.5):
        error = [value for at_s, value in errors.items() if at_s <= time_s][-1]
        step = SimpleNamespace(
            time_s=float(time_s), metrics=SimpleNamespace(shape=SimpleNamespace(error=error))
        )
        times += [float(time_s)] if ending.shows(step) else []
    return times


class TestEnd:
    RULES = ("goal.shape_error=0.01", "goal.hold_s=5", "duration_s=40", "video.after_s=3")

    def test_video_ends_after_held_shape(self) -> None:
        times = shown(load_mission("triangle", self.RULES), {0: 1.0, 10: 0.0})
        assert times[-1] == 9.5 + 5 + 3

    def test_lost_shape_continues_video(self) -> None:
        times = shown(load_mission("triangle", self.RULES), {0: 1.0, 10: 0.0, 30: 1.0})
        assert 29.5 not in times and 30.0 in times and times[-1] == 39.5

    def test_unreached_shape_is_shown_to_the_end(self) -> None:
        assert len(shown(load_mission("triangle", self.RULES), {0: 1.0})) == 80

    def test_outage_is_shown(self) -> None:
        mission = load_mission("triangle", [*self.RULES, "units.0.outages=[[25, 28]]"])
        assert shown(mission, {0: 0.0})[-1] == 28 + 5 + 3

    def test_rule_run_shows_everything(self) -> None:
        assert len(shown(load_mission("triangle", [*self.RULES, "video.end=run"]), {0: 0.0})) == 80


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"video": {"end": "later"}}, "video.end"),
        ({"video": {"speed": 0}}, "video.speed"),
        ({"video": {"after_s": -1}}, "video.after_s"),
    ],
)
def test_wrong_video_table_is_rejected(scenario_tree, change, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_mission(scenario_tree("triangle") | change)


def test_outline_of_unknown_point_is_rejected(scenario_tree) -> None:
    tree = scenario_tree("triangle")
    tree["template"]["outline"] = [[0, 77]]
    with pytest.raises(InputError, match=r"outline.*77"):
        make_mission(tree)


def test_outline_of_points_in_image_sense() -> None:
    mission = load_mission("triangle")
    points = to_complex(np.array(mission.scenario.template.points)).conj()
    (order,) = mission.scenario.template.outline
    np.testing.assert_allclose(mission.outline_at(0.0)[0], points[order])


def test_outline_does_not_depend_on_the_ids() -> None:
    usual, other = load_mission("triangle"), load_mission("triangle", ["robots.ids=[8, 9, 17, 47, 1, 2]"])
    np.testing.assert_allclose(other.outline_at(0.0)[0], usual.outline_at(0.0)[0])


def test_outline_without_points_is_rejected() -> None:
    with pytest.raises(InputError, match=r"outline: no points that it may join"):
        load_mission("letters", ["template.outline=[[0, 1]]"])
