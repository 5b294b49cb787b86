"""Sequence of shapes: the present shape in the file, in the loop and in the recording."""

import numpy as np
import pytest

from skyherd.analysis.history import make_history
from skyherd.analysis.summary import summarize
from skyherd.control import Schedule, Template
from skyherd.datasets import make_mission
from skyherd.datasets.generated.crowded_missions import crowded_mission
from skyherd.errors import InputError
from skyherd.loop import run_steps
from skyherd.recording.reader import read_recording
from skyherd.recording.writer import McapRecorder

IDS = np.arange(3)
FIRST, SECOND, THIRD = (Template(IDS, np.array([0, 1, z])) for z in (1j, 2j, 3j))


def test_schedule_returns_shape_from_its_time_on() -> None:
    program = Schedule(FIRST, ((5.0, SECOND), (8.0, THIRD)))
    assert [program.at(t) for t in (0.0, 4.9, 5.0, 7.9, 8.0, 99.0)] == [
        FIRST,
        FIRST,
        SECOND,
        SECOND,
        THIRD,
        THIRD,
    ]


@pytest.mark.parametrize(
    ("later", "said"),
    [
        (((8.0, SECOND), (5.0, THIRD)), "ascend"),
        (((0.0, SECOND),), "ascend"),
        (((5.0, Template(np.arange(2), np.array([0, 1]))),), "another team"),
    ],
)
def test_schedule_rejects_invalid_sequence(later, said) -> None:
    with pytest.raises(InputError, match=said):
        Schedule(FIRST, later)


def test_schedule_error_for_wrong_shape_names_key(scenario_tree) -> None:
    tree = scenario_tree("triangle")
    tree["template"]["then"] = [{"at_s": 30.0, "shape": "circle", "points": [[0, 0]]}]
    with pytest.raises(InputError, match=r"template\.then.*exactly one of points, shape and image"):
        make_mission(tree)


@pytest.fixture(scope="module")
def two_shapes():
    """Return mission and steps of one unit and about a dozen robots in a crowd: two shapes, 15 s each."""
    tree = crowded_mission(4) | {"perception": "ideal", "duration_s": 30.0}
    tree["template"]["then"] = [{"at_s": 15.0, "shape": "circle"}]
    mission = make_mission(tree)
    return mission, list(run_steps(mission))


def test_team_forms_scheduled_shapes_in_order(two_shapes) -> None:
    mission, steps = two_shapes
    errors = {round(step.time_s, 1): step.metrics.shape.error for step in steps}
    assert errors[14.8] < 0.01 and errors[30.0] < 0.01
    assert errors[15.0] > 0.1, "the new shape is another one"
    radii = np.abs(steps[-1].positions_m - steps[-1].positions_m.mean(axis=0))
    distances = np.linalg.norm(radii, axis=1)
    assert np.ptp(distances) < 0.03 * distances.mean(), "a circle"
    roles = [tuple(step.roles.tolist()) for step in steps]
    assert len(set(roles)) >= 2 and roles[-1] != tuple(range(mission.ids.size))
    gaps = [float(mission.bodies.gaps_m(step.positions_m).min()) for step in steps]
    assert min(gaps) > 0


def test_recording_contains_roles_and_all_shapes(two_shapes, tmp_path) -> None:
    """The run read back is identical, including its summary: later drawings know the roles."""
    mission, steps = two_shapes
    with McapRecorder(tmp_path / "run.mcap", mission) as recorder:
        for step in steps:
            recorder.write(step)
        recorder.finish(30.0, 1.0)
    recording = read_recording(tmp_path / "run.mcap")
    assert [at_s for at_s, _ in recording.mission.later] == [15.0]
    before, after = (
        summarize(make_history(*run), 1.0) for run in ((mission, steps), (recording.mission, recording.steps))
    )
    assert before.keys() == after.keys() and before["role_exchanges"] >= 2 and before["collisions"] == 0
    for key, value in before.items():  # sums over arrays elsewhere in memory may differ in the last bit
        assert after[key] == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value), key
    first, again = steps[10].frames[0].decision, recording.steps[10].frames[0].decision
    assert np.array_equal(first.proximity.distances_sides, again.proximity.distances_sides)
    assert first.report.roles.precedence == again.report.roles.precedence
