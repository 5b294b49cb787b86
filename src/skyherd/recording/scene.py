"""A run as a scene in Foxglove's schemas, which MCAP viewers draw without configuration.

Topics:

```text
/scene/bodies       once: robots with their ids, units, obstacles; each in a frame of its own
/scene/poses        poses of these frames in the frame `ground`, at each step
/scene/shape        lines of the best-fitting shape on the ground, at each step
/unit/J/overlay     markers in the image, with recorded images only
```

Poses are the true ones, as in `/world`. `skyherd.recording.reader` does not need these topics.
"""

from typing import Any

import numpy as np

from skyherd.control import fit_similarity
from skyherd.datasets import Mission
from skyherd.drawing.palette import INK, MUTED, PAPER, TEMPLATE_COLOR, unit_color
from skyherd.errors import DegenerateSetError
from skyherd.geometry import to_complex, to_points
from skyherd.loop import Step, UnitFrame
from skyherd.messages import among
from skyherd.recording import foxglove
from skyherd.recording.mcap_log import Schema

GROUND = "ground"
"""Frame of the ground: x and y in metres, z up."""

THICKNESS = 0.2
"""Height of a robot's or a unit's box over its side. Chosen: flat, so that the scene from above is a map."""

TEXT_PX = 14.0
"""Size of ids, px. Chosen: legible beside a marker."""

SCENE_TOPICS: dict[str, Schema] = {
    "/scene/bodies": foxglove.SCENE,
    "/scene/poses": foxglove.TRANSFORMS,
    "/scene/shape": foxglove.SCENE,
}
"""Topics of the scene, and their schemas."""


def bodies_message(mission: Mission) -> dict[str, Any]:
    """Return the bodies of robots, units and obstacles, each in its own frame."""
    scenario = mission.scenario
    side_m, bodies = scenario.marker.side_m, mission.bodies
    entities = []
    for robot in mission.ids.tolist():
        box = foxglove.cube((side_m, side_m, THICKNESS * side_m), INK)
        disc = foxglove.cylinder(2 * bodies.radius_m, THICKNESS * side_m, MUTED)
        parts = {"cubes": [box], "texts": [foxglove.scene_text(str(robot), INK, TEXT_PX)]}
        parts["cylinders"] = [disc] if bodies.radius_m else []
        entities.append(foxglove.entity(0.0, f"robot/{robot}", f"robot/{robot}", **parts))
    for unit in range(len(scenario.units)):
        box = foxglove.cube((side_m, side_m, THICKNESS * side_m), unit_color(unit))
        text = foxglove.scene_text(f"unit {unit}", unit_color(unit), TEXT_PX)
        entities.append(foxglove.entity(0.0, f"unit/{unit}", f"unit/{unit}", cubes=[box], texts=[text]))
    for obstacle, radius_m in zip(mission.obstacle_ids.tolist(), bodies.obstacle_radii_m, strict=True):
        disc = foxglove.cylinder(2 * float(radius_m), THICKNESS * side_m, MUTED)
        name = f"obstacle/{obstacle}"
        entities.append(foxglove.entity(0.0, name, name, cylinders=[disc]))
    return foxglove.scene_update(entities)


def poses_message(mission: Mission, step: Step) -> dict[str, Any]:
    """Return the poses of all bodies on the ground at a step."""
    places = {
        f"robot/{robot}": (x, y, 0.0, heading)
        for robot, (x, y), heading in zip(
            mission.ids.tolist(), step.positions_m.tolist(), step.headings_rad.tolist(), strict=True
        )
    }
    fleet = step.fleet
    states = np.column_stack([fleet.positions_m, fleet.heights_m, fleet.yaws_rad]).tolist()
    places |= {f"unit/{unit}": tuple(state) for unit, state in enumerate(states)}
    places |= {
        f"obstacle/{obstacle}": (x, y, 0.0, 0.0)
        for obstacle, (x, y) in zip(
            mission.obstacle_ids.tolist(), mission.bodies.obstacles_m.tolist(), strict=True
        )
    }
    return foxglove.frame_transforms(step.time_s, GROUND, places)


def shape_message(mission: Mission, step: Step) -> dict[str, Any]:
    """Return the lines of the best-fitting shape at a step; none if the robots define no similarity."""
    template = mission.shape_at(step.time_s, step.roles).points_of(mission.ids).conj()
    try:
        fit = fit_similarity(template, to_complex(step.positions_m))
    except DegenerateSetError:
        return foxglove.scene_update([])
    lines = [
        foxglove.line_strip(to_points(fit(line.conj())), TEMPLATE_COLOR)
        for line in mission.outline_at(step.time_s)
    ]
    return foxglove.scene_update([foxglove.entity(step.time_s, "shape", GROUND, lines=lines)])


def overlay_message(unit: int, time_s: float, frame: UnitFrame) -> dict[str, Any]:
    """Return outlines, headings and ids of the markers in a unit's image.

    Those that it controls have its colour.
    """
    seen, overlay = frame.sight.detections, foxglove.Overlay(time_s)
    controlled = among(seen.ids, frame.decision.report.controlled_ids)
    for corners_px, center_px, robot, own in zip(
        seen.corners_px, seen.centers_px, seen.ids.tolist(), controlled.tolist(), strict=True
    ):
        color = unit_color(unit) if own else MUTED
        overlay.lines(foxglove.LINE_LOOP, corners_px, color)
        ahead = np.stack([center_px, corners_px[:2].mean(axis=0)])
        overlay.lines(foxglove.LINE_LIST, ahead, color)
        overlay.text(corners_px[2], str(robot), INK, PAPER)
    return overlay.message
