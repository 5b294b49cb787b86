"""One MCAP file a run: every message as it passed, written as the run goes.

A topic for each vehicle and kind of message, JSON with a schema, so that any MCAP viewer opens it. A run
that is killed leaves a file that reads up to its last whole chunk.

Topics: `/mission` (first), `/unit/J/detections`, `/unit/J/goals`, `/unit/J/proximity` (where robots
keep apart), `/unit/J/report`, `/unit/J/flight`,
`/unit/J/map` (of a unit that rectifies), `/unit/J/truth`, `/unit/J/image` (on request),
`/robots/command`, `/world`, `/metrics` (last of a step), `/end` (of a run that came to its end).
"""

import base64
from dataclasses import fields
from pathlib import Path
from types import TracebackType
from typing import Any, Self

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
JPEG_QUALITY = 90

OBJECT = {"type": "object"}
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


class Recorder:
    """Writes a run to `path`; use it as a context manager, and `finish` a run that came to its end."""

    def __init__(self, path: Path, mission: Mission, *, images: bool = False) -> None:
        self.images = images
        self._file = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(library=f"skyherd {__version__}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._put("/mission", 0.0, _mission_record(mission), "skyherd.Mission")

    def write(self, step: Step) -> None:
        """Append all messages of one step."""
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
        """Mark the run as complete; its wall time is metadata, since messages repeat with the seed."""
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
        self._put(topic, time_s, value, f"skyherd.{type(value).__name__}", type(value))

    def _put(
        self, topic: str, time_s: float, record: Any, schema: str, kind: type | dict[str, Any] = OBJECT
    ) -> None:
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
