"""Interventions of an operator as plain tables without a time: merged, dated, and undone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skyherd.datasets import (
    CameraIntervention,
    CoverIntervention,
    Intervention,
    Mission,
    ShapeModel,
    read_interventions,
)
from skyherd.geometry import to_points
from skyherd.loop import Step

Table = Mapping[str, Any]
"""Intervention as in a scenario file, without its time."""

TARGETS = ("unit", "robot", "marker")
"""Keys that name what an intervention changes. Derived from the models of interventions."""

OPPOSITES = {"kill": "revive", "revive": "kill"}
"""Kinds that undo each other."""


def target_of(table: Table) -> tuple[str, int]:
    """Return the kind and the number of what a table changes; the kinds of a unit's life are one."""
    kind = "life" if table["kind"] in OPPOSITES else str(table["kind"])
    return kind, next((table[key] for key in TARGETS if key in table), -1)


def merged(tables: Sequence[Table], added: Sequence[Table]) -> list[Table]:
    """Return tables with later ones merged into those of the same target; the last value of a key counts."""
    by_target = {target_of(table): table for table in tables}
    for table in added:
        target = target_of(table)
        is_shape = table["kind"] == "template"
        by_target[target] = table if is_shape else {**by_target.get(target, {}), **table}
    return list(by_target.values())


def dated(tables: Sequence[Table], time_s: float) -> tuple[Intervention, ...]:
    """Return tables as interventions at a time, s.

    Raises:
        InputError: a table is not a valid intervention; one line for each problem.
    """
    return read_interventions([{**table, "at_s": time_s} for table in tables])


def restoring(table: Table, mission: Mission, step: Step) -> Table:
    """Return the intervention that restores the values which another one is about to change.

    Args:
        table: a valid intervention.
        mission: the mission with all interventions so far.
        step: the last step.
    """
    keys = [key for key in table if key not in ("kind", *TARGETS)]
    head = {key: table[key] for key in table if key in ("kind", *TARGETS)}
    scenario = mission.scenario_at(step.time_s)
    match table["kind"]:
        case "kill" | "revive":
            return {**head, "kind": OPPOSITES[table["kind"]]}
        case "cover":
            return {**head, "covered": table["marker"] in covered_markers(mission)}
        case "unit":
            values = unit_values(mission, step, table["unit"])
        case "camera":
            values = camera_values(mission, step, table["unit"])
        case "robot":
            row = int(np.flatnonzero(mission.ids == table["robot"])[0])
            values = {
                "position_m": step.positions_m[row].tolist(),
                "heading_deg": float(np.degrees(step.headings_rad[row])),
            }
        case "network":
            values = scenario.network.model_dump()
        case "control":
            values = scenario.control.model_dump()
        case _:
            return {**head, **shape_values(mission, step.time_s)}
    return {**head, **{key: values[key] for key in keys}}


def unit_values(mission: Mission, step: Step, unit: int) -> dict[str, Any]:
    """Return a unit's place and attitude, with the keys of the kind `unit`."""
    fleet = step.fleet
    return {
        "position_m": fleet.positions_m[unit].tolist(),
        "height_m": float(fleet.heights_m[unit]),
        "yaw_deg": float(np.degrees(fleet.yaws_rad[unit])),
        "tilt_deg": list(mission.scenario_at(step.time_s).units[unit].tilt_deg),
    }


def camera_values(mission: Mission, step: Step, unit: int) -> dict[str, Any]:
    """Return the values of a unit's camera, with the keys of the kind `camera`."""
    scenario = mission.scenario_at(step.time_s)
    model, sensor = scenario.units[unit], scenario.sensor
    times_s, zooms = zip(*model.zoom, strict=True)
    values: dict[str, Any] = {
        "psf_px": sensor.psf_px,
        "noise": sensor.noise,
        "exposure_s": sensor.exposure_s,
        "gain": sensor.gain,
        "frame_loss": scenario.network.frame_loss,
    }
    for one in scenario.interventions_in_order:
        if isinstance(one, CameraIntervention) and one.unit == unit and one.at_s <= step.time_s:
            values |= {key: value for key, value in one.changes.items() if key in values}
    return values | {
        "zoom": float(np.interp(step.time_s, times_s, zooms)),
        "distortion": model.camera.distortion.model_dump(),
        "aspect": model.camera.aspect,
    }


def covered_markers(mission: Mission) -> set[int]:
    """Return the markers that the interventions so far have covered."""
    covered: set[int] = set()
    for one in mission.scenario.interventions_in_order:
        if isinstance(one, CoverIntervention):
            (covered.add if one.covered else covered.discard)(one.marker)
    return covered


def shape_values(mission: Mission, time_s: float) -> dict[str, Any]:
    """Return the shape to form at a time, s, with the keys of the kind `template`.

    A shape from a picture is given as points, since interventions have no folder of their own.
    """
    shapes: list[ShapeModel] = [model for _, model in mission.scenario.later_shapes if model.at_s <= time_s]
    shape = shapes[-1] if shapes else mission.scenario.template
    given = shape.model_dump(include={"points", "shape", "outline"}, exclude_none=True)
    if shape.image is None:
        return given
    ids = np.array(mission.scenario.robots.ids or mission.ids)
    return {"points": to_points(mission.schedule.at(time_s).points_of(ids).conj()).tolist()}
