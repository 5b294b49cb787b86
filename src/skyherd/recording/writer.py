"""Recording of runs during the run: the interface of recorders, and the MCAP recorder.

An MCAP file holds every message of a run in its original form. Each vehicle and kind of message has a topic,
as JSON with a schema, so that any MCAP viewer opens it. All other outputs (figures, summary, page) are made
from this file, never from the run itself.

The file is written in chunks of whole steps, at least every half second of simulated time
(`skyherd.recording.mcap_log.FLUSH_S`): a killed run loses no more. The mission is written twice before the
first step, in separate chunks, so that damage to one of them costs nothing. Messages are numbered
consecutively. Chunks, data and footer have checksums, and the footer has the number of messages.
`skyherd.recording.survey` uses them to check the integrity of a file.

Topics, J being the number of a unit:

```text
/mission            first, and once more: the scenario, the template, the robots' start, the versions, and
                    the topics in the order of their channel numbers
/end                at a normal end of the run: the number of steps
/unit/J/detections  detections in an image
/unit/J/goals       to the robots that it controls; missing while it has none
/unit/J/turns       to robots that it makes turn, to tell them from copies; missing if there are none
/unit/J/proximity   bodies near the robots, for avoidance; missing without bodies
/unit/J/report      to the other units
/unit/J/flight      to its own autopilot
/unit/J/map         map from the image to the ground, of a unit that rectifies
/unit/J/truth       markers that were whole in the image, and which of them were detected
/unit/J/image       the image, on request
/unit/J/overlay     markers in that image
/robots/command     wheel velocities
/world              true positions of robots and units
/interventions      changes made to the simulation since the last step; missing without any
/scene/...          bodies, poses and shape for viewers (`skyherd.recording.scene`)
/metrics            ground-truth metrics, last of a step
```

The same scenario and seed give the same messages, to the byte. The wall time varies, and is therefore
metadata of the file instead of a message.
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import cv2
import numpy as np

from skyherd.control import GroundMap, Template
from skyherd.datasets import Mission
from skyherd.loop import Step, UnitFrame
from skyherd.messages import (
    Detections,
    FlightCommand,
    MotionGoals,
    Proximity,
    UnitReport,
    VelocityCommand,
)
from skyherd.recording import foxglove, scene
from skyherd.recording.mcap_log import McapLog, Schema
from skyherd.sim.truth_metrics import TruthMetrics
from skyherd.version import __version__

JPEG_QUALITY = 90
"""Quality of recorded images, per cent. Chosen: a video made of them looks like one of the originals; they
are not for measurements, since JPEG moves edges."""

OBJECT: dict[str, Any] = {"type": "object"}
"""JSON schema of messages that are not dataclasses."""

UNIT_TOPICS: Mapping[str, Schema] = {
    "detections": ("skyherd.Detections", Detections),
    "goals": ("skyherd.MotionGoals", MotionGoals),
    "turns": ("skyherd.MotionGoals", MotionGoals),
    "proximity": ("skyherd.Proximity", Proximity),
    "report": ("skyherd.UnitReport", UnitReport),
    "flight": ("skyherd.FlightCommand", FlightCommand),
    "map": ("skyherd.GroundMap", GroundMap),
    "truth": ("skyherd.SightTruth", OBJECT),
    "image": foxglove.IMAGE,
    "overlay": foxglove.ANNOTATIONS,
}
"""Topics of each unit, and their schemas."""


def recorded_topics(units: int) -> dict[str, Schema]:
    """Return the topics of a run of so many units, in the order of channel numbers, with their schemas.

    All are registered at the start, so that no chunk depends on another.
    """
    of_team: dict[str, Schema] = {
        "/mission": ("skyherd.Mission", OBJECT),
        "/end": ("skyherd.End", OBJECT),
        "/robots/command": ("skyherd.VelocityCommand", VelocityCommand),
        "/world": ("skyherd.World", OBJECT),
        "/metrics": ("skyherd.TruthMetrics", TruthMetrics),
    }
    of_team |= scene.SCENE_TOPICS
    of_units = {
        f"/unit/{unit}/{name}": schema for unit in range(units) for name, schema in UNIT_TOPICS.items()
    }
    return of_team | of_units | {"/interventions": ("skyherd.Interventions", OBJECT)}


class Recorder(Protocol):
    """Receiver of the steps of a run; `skyherd.runner.run_mission` accepts any number of them.

    A recorder is a context manager. The run enters it before its first step and exits it after its last.
    `write` is called once per step, in the order of time, from one thread, and the run waits for it.

    A step is an item of `skyherd.loop.run_steps`. It may be kept unchanged, except for the camera images in
    `step.frames[unit].sight.image`, which take much memory (`step.without_images()` returns the step without
    them). A recorder must not change a step.

    If the context is exited without an exception, the recording must be complete and closed. If it is exited
    with one (an interrupt, a failed write), the recorder closes its files and lets the exception pass. It
    decides itself whether a partial recording is useful. An exception from `write` ends the run:
    `skyherd.errors.OutputError` or OSError where writing failed.
    """

    def write(self, step: Step) -> None:
        """Record one step."""

    def __enter__(self) -> Any:
        """Begin the run."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> bool | None:
        """End the run: close all files. Returns nothing true, since exceptions pass."""


class McapRecorder:
    """A `Recorder` that writes a run's messages to an MCAP file.

    Exiting the context closes the file. `finish`, called before that, marks a normal end of the run; without
    it the file reads as an incomplete run.

    Args:
        path: the file to create; an existing one is replaced.
        mission: mission of the run.
        images: record the cameras' images as well, as JPEG.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, mission: Mission, *, images: bool = False) -> None:
        self.images = images
        self._mission = mission
        topics = recorded_topics(len(mission.scenario.units))
        self._log = McapLog(path, topics)
        self._steps = 0
        record = _mission_record(mission) | {"topics": list(topics)}
        for _ in range(2):
            self._log.put("/mission", 0.0, record)
            self._log.flush()
        self._log.put("/scene/bodies", 0.0, scene.bodies_message(mission))

    def write(self, step: Step) -> None:
        """Append all messages of one step, and flush if too much is pending."""
        known = self._mission.scenario.interventions
        asked = [intervention for intervention in step.interventions if intervention not in known]
        self._mission = self._mission.with_interventions(asked)
        for unit, frame in step.frames.items():
            self._write_frame(unit, step.time_s, frame)
        self._log.put("/robots/command", step.time_s, step.command)
        world = {
            "positions_m": step.positions_m,
            "headings_rad": step.headings_rad,
            "fleet": step.fleet,
        }
        self._log.put("/world", step.time_s, world)
        if step.interventions:
            changes = [intervention.model_dump(mode="json") for intervention in step.interventions]
            self._log.put("/interventions", step.time_s, {"interventions": changes})
        self._log.put("/scene/poses", step.time_s, scene.poses_message(self._mission, step))
        self._log.put("/scene/shape", step.time_s, scene.shape_message(self._mission, step))
        record = {field.name: getattr(step.metrics, field.name) for field in fields(TruthMetrics)} | {
            "control_sets": step.control_sets,
            "commanded_ids": step.commanded_ids,
            "roles": step.roles,
        }
        self._log.put("/metrics", step.time_s, record)
        self._steps += 1
        self._log.flush_when_due(step.time_s, step.time_s + self._mission.scenario.step_s)

    def finish(self, time_s: float, wall_s: float) -> None:
        """Mark the run as complete.

        Args:
            time_s: simulated time of the last step.
            wall_s: wall time of the run.
        """
        self._log.put("/end", time_s, {"steps": self._steps})
        self._log.flush()
        self._log.add_metadata("wall", {"wall_s": repr(wall_s)})

    def _write_frame(self, unit: int, time_s: float, frame: UnitFrame) -> None:
        topic = f"/unit/{unit}"
        sight, decision = frame.sight, frame.decision
        self._log.put(f"{topic}/detections", time_s, sight.detections)
        if decision.goals is not None:
            self._log.put(f"{topic}/goals", time_s, decision.goals)
        if decision.turns is not None:
            self._log.put(f"{topic}/turns", time_s, decision.turns)
        if decision.proximity is not None:
            self._log.put(f"{topic}/proximity", time_s, decision.proximity)
        if not decision.suspicion:
            self._log.put(f"{topic}/report", time_s, decision.report)
        self._log.put(f"{topic}/flight", time_s, decision.flight)
        if not frame.decision.ground_map.ideal:
            self._log.put(f"{topic}/map", time_s, frame.decision.ground_map)
        truth = {
            "whole_ids": sight.whole_ids,
            "found_ids": sight.found_ids,
            "false_detections": sight.false_detections,
        }
        self._log.put(f"{topic}/truth", time_s, truth)
        if self.images and sight.image is not None:
            record = foxglove.compressed_image(sight.image, time_s, topic, JPEG_QUALITY)
            self._log.put(f"{topic}/image", time_s, record)
            self._log.put(f"{topic}/overlay", time_s, scene.overlay_message(unit, time_s, frame))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._log.close()


def _pairs(template: Template) -> list[list[float]]:
    return [[z.real, z.imag] for z in template.points_px.tolist()]


def _mission_record(mission: Mission) -> dict[str, Any]:
    return {
        "version": __version__,
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "scenario": mission.scenario.model_dump(mode="json"),
        "template_ids": mission.template.ids.tolist(),
        "template_px": _pairs(mission.template),
        "later": [{"at_s": at_s, "template_px": _pairs(shape)} for at_s, shape in mission.later],
        "ids": mission.ids.tolist(),
        "positions_m": mission.positions_m.tolist(),
        "headings_rad": mission.headings_rad.tolist(),
    }
