"""Recall by the truth: a marker counts as found only where it is."""

from itertools import islice

import numpy as np
import pytest

from skyherd.datasets import load_mission, scenario_names
from skyherd.loop import run_steps
from skyherd.messages import Detections
from skyherd.sim.perception import RenderedPerception
from skyherd.sim.physics import make_world


class Wrong:
    """The mission's detector, with one detection moved by a share of its side, or given another id."""

    def __init__(self, detector, *, moved_sides=0.0, other_id=None):
        self.detector, self.moved_sides, self.other_id = detector, moved_sides, other_id

    def detect(self, image, *, time_s=0.0, unit_id=0):
        seen = self.detector.detect(image, time_s=time_s, unit_id=unit_id)
        shift = np.zeros((len(seen), 2))
        shift[0, 0] = self.moved_sides * seen.sides_px[0]
        ids = seen.ids.copy()
        self.changed = int(ids[0])
        ids[0] = ids[0] if self.other_id is None else self.other_id
        values = vars(seen) | {"ids": ids, "centers_px": seen.centers_px + shift}
        return Detections(**{name: values[name] for name in Detections.__dataclass_fields__})


@pytest.mark.parametrize(
    ("how", "found"),
    [({"moved_sides": 0.4}, True), ({"moved_sides": 0.6}, False), ({"other_id": 49}, False)],
)
def test_a_detection_in_a_wrong_place_is_false_and_finds_nothing(how, found):
    mission = load_mission("star", ["sensor.noise=1"])
    perception, world = RenderedPerception(mission, np.random.default_rng(1)), make_world(mission)
    perception.detector = Wrong(perception.detector, **how)
    (sight,) = perception.look(world, [0], 0.0)
    changed = perception.detector.changed
    assert changed in sight.whole_ids
    assert (changed in sight.found_ids) == found
    assert sight.false_detections == (0 if found else 1)
    assert set(sight.whole_ids) - set(sight.found_ids) == (set() if found else {changed})


@pytest.mark.parametrize(
    "name",
    ["triangle", *(pytest.param(n, marks=pytest.mark.slow) for n in scenario_names() if n != "triangle")],
)
@pytest.mark.parametrize("kind", ["rendered", "noisy"])
def test_every_scenario_runs_on_opencvs_detector_alone(name, kind):
    """Its detections, of which it tells no covariance, go through the loop: most markers of the first images
    are there, and controllers set goals for all robots that they control."""
    mission = load_mission(name, ["detector=opencv", f"perception={kind}"])
    step, _ = islice(run_steps(mission), 2)
    sights = [frame.sight for frame in step.frames.values()]
    found, whole = (sum(ids.size for ids in lists) for lists in zip(*map(_ids_of, sights), strict=True))
    assert found >= 0.6 * whole > 0
    assert all(sight.detections.covariances.any() == (kind == "noisy") for sight in sights)
    for frame in step.frames.values():
        goals = frame.decision.goals
        controlled = frame.decision.report.controlled_ids
        assert np.array_equal(np.sort(controlled), np.zeros(0) if goals is None else np.sort(goals.ids))


def _ids_of(sight):
    return sight.found_ids, sight.whole_ids
