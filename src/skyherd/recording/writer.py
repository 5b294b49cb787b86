"""What records a run while it goes on: the interface of recorders, and the one that writes MCAP files.

An MCAP file holds every message of a run as it passed. There is a topic for each vehicle and kind of message,
as JSON with a schema, so that any MCAP viewer opens it. The file is written in chunks as the run goes: a run
that is killed leaves a file that can be read up to its last whole chunk. Everything else (figures, summary,
page) is made from this file, never from the run itself.

Topics, J being the number of a unit:

    /mission            first: the scenario, the template, the robots' start, and the versions that ran it
    /unit/J/detections  what the unit's detector found in an image
    /unit/J/goals       to the robots that it controls; missing while it has none
    /unit/J/proximity   where robots keep apart: what else is near them; missing without bodies
    /unit/J/report      to the other units
    /unit/J/flight      to its own autopilot
    /unit/J/map         its map from the image to the ground, of a unit that rectifies
    /unit/J/truth       which markers were whole in the image, and which of them were detected
    /unit/J/image       the image, on request
    /robots/command     the velocities that the wheels were given
    /world              where robots and units truly are
    /metrics            judged from the truth, and last of a step
    /end                of a run that came to its end

The same scenario and seed give the same messages, to the byte. The wall time, which differs, therefore is
metadata of the file and no message.
"""

import base64
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import cv2
import numpy as np
from mcap.writer import CompressionType, Writer

from skyherd.control import Template
from skyherd.datasets import Mission
from skyherd.loop import Step, UnitFrame
from skyherd.recording.json_codec import json_schema, to_json
from skyherd.sim.truth_metrics import TruthMetrics
from skyherd.version import __version__

CHUNK_BYTES = 1 << 16
"""Size at which a chunk of messages is compressed and written. Chosen: a run that is killed loses less than
one chunk; smaller chunks compress worse."""

JPEG_QUALITY = 90
"""Quality of recorded images, in per cent. Chosen: a video made of them looks like one of the originals; they
are not for measuring, since JPEG moves edges."""

OBJECT = {"type": "object"}
"""JSON schema of messages that are no dataclass."""

IMAGE_SCHEMA = {
    "type": "object",
    "title": "foxglove.CompressedImage",
    "properties": {
        "timestamp": {
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "frame_id": {"type": "string"},
        "data": {"type": "string", "contentEncoding": "base64"},
        "format": {"type": "string"},
    },
}


class Recorder(Protocol):
    """Whatever keeps the steps of a run; `skyherd.runner.run_mission` takes any number of them.

    A recorder is a context manager, whose context the run enters before its first step and leaves after its
    last. `write` is called once a step, in the order of time, from one thread, and the run waits for it. A
    step is what `skyherd.loop.run_steps` yields: it may be kept as it is, but for the camera images in
    `step.frames[unit].sight.image`, which take much memory (`step.without_images()` is the same step without
    them). A recorder must not change a step.

    If the context is left without an exception, whatever is recorded must be whole and closed. If it is left
    with one (the run was interrupted, a file could not be written), the recorder closes its files and lets
    the exception pass; whether a part of a recording is useful is its own decision. An exception that `write`
    raises ends the run: `skyherd.errors.OutputError` or OSError where something cannot be written.
    """

    def write(self, step: Step) -> None:
        """Record one step."""

    def __enter__(self) -> Any:
        """The run begins."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> bool | None:
        """The run is over: close all files. Returns nothing true, since exceptions pass."""


class McapRecorder:
    """A `Recorder` that writes a run's messages to an MCAP file.

    Leaving the context closes the file, and `finish`, called before that, marks a run that came to its end:
    without it the file reads as a run that was cut short.

    Args:
        path: the file to make; one that is there is replaced.
        mission: what is run.
        images: record the cameras' images as well, as JPEG.

    Raises:
        OSError: the file cannot be written.
    """

    def __init__(self, path: Path, mission: Mission, *, images: bool = False) -> None:
        self.images = images
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(library=f"skyherd {__version__}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._put("/mission", 0.0, _mission_record(mission), "skyherd.Mission")

    def write(self, step: Step) -> None:
        """Append all messages of one step, and flush what is a whole chunk by then."""
        for unit, frame in step.frames.items():
            self._write_frame(f"/unit/{unit}", step.time_s, frame)
        self._put_value("/robots/command", step.time_s, step.command)
        world = {
            "positions_m": step.positions_m,
            "headings_rad": step.headings_rad,
            "fleet": step.fleet,
        }
        self._put("/world", step.time_s, world, "skyherd.World")
        record = {field.name: getattr(step.metrics, field.name) for field in fields(TruthMetrics)} | {
            "control_sets": step.control_sets,
            "commanded_ids": step.commanded_ids,
            "roles": step.roles,
        }
        self._put("/metrics", step.time_s, record, "skyherd.TruthMetrics", TruthMetrics)
        self._file.flush()  # a killed run keeps all chunks that were whole by then

    def finish(self, time_s: float, wall_s: float) -> None:
        """Mark the run as complete.

        Args:
            time_s: simulated time of the last step.
            wall_s: wall time that the run took.
        """
        self._put("/end", time_s, {}, "skyherd.End")
        self._writer.add_metadata("wall", {"wall_s": repr(wall_s)})

    def _write_frame(self, topic: str, time_s: float, frame: UnitFrame) -> None:
        sight, decision = frame.sight, frame.decision
        self._put_value(f"{topic}/detections", time_s, sight.detections)
        if decision.goals is not None:
            self._put_value(f"{topic}/goals", time_s, decision.goals)
        if decision.proximity is not None:
            self._put_value(f"{topic}/proximity", time_s, decision.proximity)
        self._put_value(f"{topic}/report", time_s, decision.report)
        self._put_value(f"{topic}/flight", time_s, decision.flight)
        if not frame.decision.ground_map.ideal:
            self._put_value(f"{topic}/map", time_s, frame.decision.ground_map)
        truth = {
            "whole_ids": sight.whole_ids,
            "found_ids": sight.found_ids,
            "false_detections": sight.false_detections,
        }
        self._put(f"{topic}/truth", time_s, truth, "skyherd.SightTruth")
        if self.images and sight.image is not None:
            _, data = cv2.imencode(".jpg", sight.image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            nanoseconds = _nanoseconds(time_s)
            record = {
                "timestamp": {"sec": nanoseconds // 10**9, "nsec": nanoseconds % 10**9},
                "frame_id": topic,
                "data": base64.b64encode(data.tobytes()).decode(),
                "format": "jpeg",
            }
            self._put(f"{topic}/image", time_s, record, "foxglove.CompressedImage", IMAGE_SCHEMA)

    def _put_value(self, topic: str, time_s: float, value: Any) -> None:
        """Append a dataclass, whose name and fields give the schema."""
        self._put(topic, time_s, value, f"skyherd.{type(value).__name__}", type(value))

    def _put(
        self, topic: str, time_s: float, record: Any, schema: str, kind: type | dict[str, Any] = OBJECT
    ) -> None:
        """Append a message; the first one of a topic makes its channel, the first of a schema its record."""
        if topic not in self._channels:
            if schema not in self._schemas:
                text = to_json(kind if isinstance(kind, dict) else json_schema(kind))
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        at, data = _nanoseconds(time_s), to_json(record)
        self._writer.add_message(self._channels[topic], log_time=at, publish_time=at, data=data)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._file.close()


def _pairs(template: Template) -> list[list[float]]:
    return [[z.real, z.imag] for z in template.points_px.tolist()]


def _nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


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
