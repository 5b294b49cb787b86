"""Scenario key `interventions`: checks, and the settings at each time."""

from typing import Any, get_args

import numpy as np
import pytest

from skyherd.datasets import Intervention, Mission, load_mission, read_interventions
from skyherd.errors import InputError

MODELS = [
    (kind, model)
    for model in get_args(get_args(Intervention)[0])
    for kind in get_args(model.model_fields["kind"].annotation)
]

GOOD = {
    "unit": {"unit": 0, "height_m": 9.0},
    "camera": {"unit": 0, "zoom": 1.5},
    "robot": {"robot": 3, "position_m": [1.0, 2.0]},
    "cover": {"marker": 3},
    "kill": {"unit": 1},
    "revive": {"unit": 1},
    "network": {"delay_s": 0.1},
    "control": {"k": 0.2},
    "template": {"shape": "circle"},
}
"""A valid intervention of each kind."""


def of(kind: str, **values: Any) -> dict[str, Any]:
    return {"at_s": 2.0, "kind": kind, **GOOD[kind], **values}


def star(*tables: dict[str, Any], settings: tuple[str, ...] = ()) -> Mission:
    return load_mission("star", [*settings, f"interventions=[{', '.join(map(toml, tables))}]"])


def toml(value: Any) -> str:
    """Return a value as TOML in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return (
        str(value).lower()
        if isinstance(value, bool)
        else f'"{value}"'
        if isinstance(value, str)
        else repr(value)
    )


def test_every_kind_has_a_good_example() -> None:
    assert {kind for kind, _ in MODELS} == GOOD.keys()
    mission = star(*(of(kind) for kind in GOOD))
    assert [one.kind for one in mission.scenario.interventions] == list(GOOD)


@pytest.mark.parametrize(("kind", "model"), MODELS)
def test_wrong_value_of_each_key_is_refused_with_its_place(kind: str, model: Any) -> None:
    for key, field in model.model_fields.items():
        if key == "kind":
            continue
        for wrong in ({"a": 1}, 1e300):
            with pytest.raises(InputError) as caught:
                star(of(kind, **{key: wrong}))
            lines = caught.value.lines
            assert all("\n" not in line and "; " in line and len(line) < 500 for line in lines), lines
            assert any(line.startswith(f"settings: interventions: 0.{key}") for line in lines), (field, lines)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"at_s": 1}, "0.kind: missing; one of camera, control, cover,"),
        ({"at_s": 1, "kind": "camra"}, "0.kind: 'camra'; did you mean 'camera'? one of camera,"),
        ({"at_s": 1, "kind": ["a"]}, "0.kind: ['a']; one of camera,"),
        (of("camera", zom=2), "0.zom: unknown key; did you mean 'zoom'?"),
        (of("kill", zoom=2), "0.zoom: unknown key; did you mean 'units.*.zoom'?"),
        ({"at_s": 1, "kind": "camera", "unit": 0}, "0: nothing to change; at least one of zoom, distortion,"),
        (of("camera", zoom=1000), "0.zoom: 1000; a finite number from 0.01 to 100"),
        (of("camera", unit=3), "0.unit: no unit 3; from 0 to 2"),
        (of("kill", at_s=-1), "0.at_s: -1; a finite number from 0 to 1000000"),
        (of("unit", height_m=200), "0.height_m: 200 is outside the autopilot's limits; from autopilot.min_"),
        (of("unit", tilt_deg=[50, 0]), "0.tilt_deg.0: 50; a finite number from -45 to 45"),
        (of("camera", distortion={"k1": -3}), "0.distortion: the lens folds the image over; smaller k1,"),
        (of("robot", robot=77), "0.robot: no robot 77; one of 0, 1, 2,"),
        (of("cover", marker=77), "0.marker: no marker 77; one of 0, 1, 2,"),
        (of("control", k_v=0.1), "0.k_v: unused with control.gains marker; leave it out"),
        (of("network", message_loss=1), "0.message_loss: 1; a finite number at least 0 and below 1"),
        (of("template", shape="cirkle"), "0.shape: no shape 'cirkle'; did you mean 'circle'? one of circle,"),
        (of("template", points=[[0, 0]]), "0: points and shape given; exactly one of points, shape and"),
        (of("template", at_s=0), "0.at_s: 0, when another shape begins; a time after the start at which no"),
    ],
)
def test_impossible_intervention_is_refused_in_one_line(table: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        star(table)
    assert len(caught.value.lines) == 1
    assert str(caught.value).startswith(f"settings: interventions: {said}")


def test_lens_is_checked_with_the_zoom_of_its_time() -> None:
    """A wider zoom sees more of a lens, up to where it folds; the order in the file does not matter."""
    lens = {"at_s": 5.0, "kind": "camera", "unit": 0, "distortion": {"k1": -0.1}}
    wide = of("camera", at_s=4.0, zoom=0.5)
    assert star(lens) and star(wide) and star(lens, of("camera", at_s=6.0, zoom=1.0))
    for tables in ([lens, wide], [wide, lens]):
        with pytest.raises(
            InputError, match=rf"interventions: {tables.index(lens)}\.distortion: the lens folds"
        ):
            star(*tables)


def test_two_shapes_at_one_time_are_refused() -> None:
    with pytest.raises(InputError, match=r"interventions: 1\.at_s: 2, when another shape begins"):
        star(of("template"), of("template", shape="line"))


def test_laws_from_literature_take_no_gains_and_no_shapes() -> None:
    for kind in ("control", "template"):
        with pytest.raises(InputError, match=r"interventions: 1: not supported by control\.method distances"):
            star(of("kill"), of(kind), settings=("control.method=distances", "size.unit_m=1"))


def test_settings_at_a_time_are_of_all_interventions_so_far() -> None:
    mission = star(
        of("camera", at_s=6.0, zoom=3.0),
        of("camera", at_s=3.0, aspect=1.2, psf_px=2.0),
        of("unit", at_s=4.0, unit=1, tilt_deg=[20.0, -5.0]),
        of("network", at_s=5.0, message_loss=0.5, delay_s=0.2),
        of("control", at_s=5.0, k=0.7),
        of("camera", at_s=3.0, zoom=2.0),
    )
    at = mission.scenario_at
    assert at(2.99) is mission.scenario
    assert [at(t).units[0].zoom for t in (2.9, 3.0, 5.9, 6.0)] == [[(0.0, z)] for z in (1.0, 2.0, 2.0, 3.0)]
    assert at(3.0).units[0].camera.aspect == 1.2 and at(3.0).units[1] is mission.scenario.units[1]
    assert at(4.0).units[1].tilt_deg == (20.0, -5.0) and at(3.9).units[1].tilt_deg == (0.0, 0.0)
    assert at(5.0).network.message_loss == 0.5 and at(4.9).network.message_loss == 0.0
    assert (at(9.0).control.k, at(9.0).control.k_omega) == (0.7, mission.scenario.control.k_omega)
    assert [camera.aspect for camera in mission.cameras_at(3.0)] == [1.2, 1.0, 1.0]


def test_unit_is_dead_while_killed_or_in_an_outage() -> None:
    """A revival ends the outage in which the unit is, and not a later one."""
    lives = [of("kill", at_s=2.0), of("revive", at_s=4.0), of("kill", at_s=11.0), of("revive", at_s=12.0)]
    mission = star(*lives, settings=("units.1.outages=[[3.0, 6.0], [8.0, 9.0], [10.0, 15.0]]",))
    dead = [time_s for time_s in np.arange(0, 20, 0.5).tolist() if mission.scenario.dead_units(time_s) == [1]]
    assert dead == [*np.arange(2, 4, 0.5), 8.0, 8.5, *np.arange(10, 12, 0.5)]


def test_added_interventions_give_the_mission_of_the_file() -> None:
    """Shapes that existed keep their identity, by which controllers notice a change."""
    tables = [of("camera"), of("template", at_s=7.0), of("template", at_s=5.0, shape="line"), of("kill")]
    whole = star(*tables)
    part = star(*tables[:2])
    added = part.with_interventions(read_interventions(tables[2:]))
    assert added.scenario == whole.scenario
    assert [at_s for at_s, _ in added.later] == [at_s for at_s, _ in whole.later] == [5.0, 7.0]
    for (_, one), (_, other) in zip(added.later, whole.later, strict=True):
        np.testing.assert_array_equal(one.points_px, other.points_px)
    assert added.template is part.template and added.later[1][1] is part.later[0][1]
    assert [len(lines) for lines in added.outlines] == [len(lines) for lines in whole.outlines]
    assert part.with_interventions(()) is part


def test_added_interventions_are_checked() -> None:
    mission = star(of("camera", zoom=0.5))
    lens = {"at_s": 2.0, "kind": "camera", "unit": 0, "distortion": {"k1": -0.1}}
    with pytest.raises(InputError) as caught:
        mission.with_interventions(read_interventions([of("kill", unit=9), of("robot", robot=99), lens]))
    keys = [problem.where for problem in caught.value.problems]
    assert keys == ["interventions.1.unit", "interventions.2.robot", "interventions.3.distortion"]


def test_interventions_are_frozen_values() -> None:
    (one,), (same,) = read_interventions([of("camera")]), read_interventions([of("camera")])
    assert one == same and hash(one) == hash(same)
    with pytest.raises(ValueError, match="frozen"):
        one.zoom = 3.0
    assert read_interventions([one.model_dump(mode="json")]) == (one,)
