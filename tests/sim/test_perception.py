"""Recall by ground truth: a marker counts as found only at its true position."""

from itertools import islice

import numpy as np
import pytest

from skyherd.datasets import load_mission, scenario_names
from skyherd.errors import InputError
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.messages import Detections
from skyherd.sim.perception import RenderedPerception, make_perception
from skyherd.sim.physics import make_world
from skyherd.vision import explain_mirrored, load_accuracy


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
    """The detections, without covariances, pass through the loop.

    The detector finds most markers of the first images, and controllers set goals for all controlled robots.
    """
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


def looks(settings, count):
    """Return `count` sights per unit by noisy perception, all of the scenario's first image."""
    mission = load_mission("star", ["perception=noisy", *settings])
    perception, world = make_perception(mission, np.random.default_rng(5)), make_world(mission)
    units = range(len(mission.scenario.units))
    return [sight for time_s in range(count) for sight in perception.look(world, units, float(time_s))]


@pytest.mark.parametrize("height_m", [20.0, 50.0, 58.0])
def test_noisy_perception_misses_markers_as_the_detector_does(height_m) -> None:
    """The recall is the measured one of that size, to 5 standard deviations of a binomial."""
    sights = looks([f"units.*.height_m={height_m}", "sensor.noise=5"], 200)
    exact = looks([f"units.*.height_m={height_m}", "perception=ideal"], 1)
    sides = np.concatenate([sight.detections.sides_px for sight in exact])
    found, whole = (sum(map(len, lists)) for lists in zip(*map(_ids_of, sights), strict=True))
    accuracy = load_accuracy("photometric", noise=5.0)
    recall = float(np.interp(sides, accuracy.sides_px, accuracy.recall, left=0.0).mean())
    assert found / whole == pytest.approx(recall, abs=5 * np.sqrt(0.25 / whole))
    assert (recall > 0.999) == (height_m == 20.0), "the sizes are on both sides of the detector's limit"


def test_no_marker_below_the_measured_sizes_is_found() -> None:
    """The table ends at 1.2 px a cell; the detector was not measured below."""
    accuracy = load_accuracy("photometric", psf_px=0.5)
    assert accuracy.recall[0] > 0.01
    sides = np.array([0.5, 0.99]) * accuracy.sides_px[0]
    assert not accuracy.found(np.repeat(sides, 1000), np.random.default_rng(0)).any()


def test_noisy_marker_errors_match_measured_accuracy() -> None:
    """Errors over 4000 markers, against the table; the corners of noisy markers are not exact either."""
    sights, (exact, *_) = looks(["sensor.noise=10"], 300), looks(["perception=ideal"], 1)
    true = exact.detections
    corners = to_complex(true.corners_px - true.centers_px[:, None])
    errors = []
    for sight in sights:
        seen = sight.detections
        if seen.unit_id != true.unit_id:
            continue
        rows = np.searchsorted(true.ids, seen.ids)
        have, want = to_complex(seen.corners_px - seen.centers_px[:, None]), corners[rows]
        parts = np.linalg.pinv(np.stack([want, want.conj()], axis=-1)) @ have[..., None]
        s, q = parts[:, 0, 0], parts[:, 1, 0]
        errors.append(
            np.column_stack(
                [
                    seen.centers_px - true.centers_px[rows],
                    seen.headings_rad - true.headings_rad[rows],
                    np.angle(s),
                    np.abs(s) - 1,
                    q.real,
                    q.imag,
                ]
            )
        )
    error = np.concatenate(errors)
    table = load_accuracy("photometric", noise=10.0)
    side = float(np.median(true.sides_px))

    def expected(values):
        return float(np.interp(side, table.sides_px, values))

    place, heading = expected(table.position_std_px), expected(table.heading_std_rad)
    grown, squeeze = expected(table.side_std), expected(table.squeeze_std)
    wanted = [place, place, heading, heading, grown, squeeze, squeeze]
    assert len(error) >= 1500
    assert error.std(axis=0) == pytest.approx(wanted, rel=0.15)
    second_order = 4 * heading * 4 * max(grown, squeeze)
    assert np.abs(error[:, 2] - error[:, 3]).max() < second_order, "corners turn with the heading"


def test_more_noise_blur_or_cells_make_markers_harder_to_read() -> None:
    """Recall at each size falls along each axis of the table; between its points errors are interpolated."""
    plain = load_accuracy("photometric", noise=2.0, psf_px=0.8)
    for worse in (
        load_accuracy("photometric", noise=10.0, psf_px=0.8),
        load_accuracy("photometric", noise=2.0, psf_px=1.2),
        load_accuracy("photometric", dictionary="6X6_250"),
    ):
        recalls = [
            np.interp(plain.sides_px, table.sides_px, table.recall, left=0) for table in (plain, worse)
        ]
        assert (recalls[1] <= recalls[0] + 0.02).all() and recalls[1].sum() < recalls[0].sum() - 0.3
    between = load_accuracy("photometric", noise=3.5)
    noisier = load_accuracy("photometric", noise=5.0)
    assert np.allclose(between.position_std_px, (plain.position_std_px + noisier.position_std_px) / 2)
    with pytest.raises(InputError, match=r"sensor.noise: .* 10 at most"):
        load_accuracy("opencv", noise=11.0)


@pytest.mark.parametrize("ids", [[0, 1, 2, 3, 4, 5], [8, 9, 17, 47, 1, 2]])
def test_mirror_image_is_searched_only_with_missing_markers(ids, monkeypatch):
    """In a mirrored image the detector finds only markers that are their own mirror images.

    A team may have many of these. With most markers found, the image is not mirrored.
    """
    asked = []
    monkeypatch.setattr(
        "skyherd.sim.perception.explain_mirrored", lambda *call: asked.append(call) or explain_mirrored(*call)
    )
    mission = load_mission("triangle", [f"robots.ids={ids}"])
    perception, world = RenderedPerception(mission, np.random.default_rng(1)), make_world(mission)
    perception.look(world, [0], 0.0)
    assert not asked
    mission = load_mission("triangle", [f"robots.ids={ids}", "units.0.camera.mirrored=true"])
    perception, world = RenderedPerception(mission, np.random.default_rng(1)), make_world(mission)
    with pytest.raises(InputError, match="mirrored"):
        perception.look(world, [0], 0.0)
    assert asked
