"""One MCAP file a run: every message as it passed, written as the run goes.

A topic for each vehicle and kind of message, JSON with a schema, so that any MCAP viewer opens it. A run
that is killed leaves a file that reads up to its last whole chunk.

Topics: `/mission` (first), `/unit/J/detections`, `/unit/J/goals`, `/unit/J/report`, `/unit/J/flight`,
`/unit/J/truth`, `/unit/J/image` (on request), `/robots/command`, `/world`, `/observer` (last of a step),
`/end` (of a run that came to its end).
"""

import base64
import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import CompressionType, Writer

from skyherd import __version__
from skyherd.control import Decision, Template
from skyherd.control.topology import Conditions
from skyherd.datasets import Mission, Scenario
from skyherd.errors import InputError
from skyherd.loop import Step, UnitFrame
from skyherd.messages import Detections, FlightCommand, MotionGoals, UnitReport, VelocityCommand
from skyherd.observer import Observation, ShapeFit
from skyherd.perception import Sight
from skyherd.plain import from_plain, json_schema, to_plain
from skyherd.world import Fleet

CHUNK_BYTES = 1 << 16
JPEG_QUALITY = 90

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
        self._put("/mission", 0.0, _mission_record(mission), "skyherd.Mission", {"type": "object"})

    def write(self, step: Step) -> None:
        """Append all messages of one step."""
        for unit, frame in step.frames.items():
            self._write_frame(f"/unit/{unit}", step.time_s, frame)
        self._put_value("/robots/command", step.time_s, step.command)
        world = {
            "positions_m": step.positions_m,
            "headings_rad": step.headings_rad,
            "fleet": to_plain(step.fleet),
        }
        self._put("/world", step.time_s, to_plain(world), "skyherd.World", {"type": "object"})
        record = to_plain(step.observation) | {
            "control_sets": to_plain(step.control_sets),
            "commanded_ids": to_plain(step.commanded_ids),
        }
        self._put("/observer", step.time_s, record, "skyherd.Observation", json_schema(Observation))
        self._file.flush()  # a killed run keeps all chunks that were whole by then

    def finish(self, time_s: float, wall_s: float) -> None:
        """Mark the run as complete; its wall time is metadata, since messages repeat with the seed."""
        self._put("/end", time_s, {}, "skyherd.End", {"type": "object"})
        self._writer.add_metadata("wall", {"wall_s": repr(wall_s)})

    def _write_frame(self, topic: str, time_s: float, frame: UnitFrame) -> None:
        sight, decision = frame.sight, frame.decision
        self._put_value(f"{topic}/detections", time_s, sight.detections)
        if decision.goals is not None:
            self._put_value(f"{topic}/goals", time_s, decision.goals)
        self._put_value(f"{topic}/report", time_s, decision.report)
        self._put_value(f"{topic}/flight", time_s, decision.flight)
        truth = {
            "whole_ids": sight.whole_ids,
            "found_ids": sight.found_ids,
            "false_detections": sight.false_detections,
        }
        self._put(f"{topic}/truth", time_s, to_plain(truth), "skyherd.SightTruth", {"type": "object"})
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
        self._put(topic, time_s, to_plain(value), f"skyherd.{type(value).__name__}", json_schema(type(value)))

    def _put(self, topic: str, time_s: float, record: Any, schema: str, definition: dict[str, Any]) -> None:
        if topic not in self._channels:
            if schema not in self._schemas:
                text = json.dumps(definition).encode()
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        data = json.dumps(record, separators=(",", ":"), allow_nan=False).encode()
        at = _nanoseconds(time_s)
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


def _nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


def _mission_record(mission: Mission) -> dict[str, Any]:
    return {
        "version": __version__,
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "scenario": mission.scenario.model_dump(mode="json"),
        "template_ids": mission.template.ids.tolist(),
        "template_px": np.column_stack(
            [mission.template.points_px.real, mission.template.points_px.imag]
        ).tolist(),
        "ids": mission.ids.tolist(),
        "positions_m": mission.positions_m.tolist(),
        "headings_rad": mission.headings_rad.tolist(),
    }


@dataclass(frozen=True)
class Recording:
    """A run read back.

    Attributes:
        mission: what was run.
        versions: of skyherd and the libraries that made it.
        steps: all steps that are whole in the file.
        wall_s: wall time of the run, None if it was cut short.
        has_images: whether camera images were recorded.
    """

    mission: Mission
    versions: dict[str, str]
    steps: list[Step]
    wall_s: float | None
    has_images: bool


def read_messages(path: Path) -> Iterator[tuple[str, float, Any]]:
    """Topic, time (s) and content of each message, up to where the file ends or breaks off.

    Metadata comes as topic `#name`, at time 0.

    Raises:
        InputError: there is no such file, or it is damaged within.
    """
    channels: dict[int, str] = {}
    try:
        with path.open("rb") as stream:
            records = StreamReader(stream, validate_crcs=True).records
            while (record := _next_whole(records)) is not None:
                if isinstance(record, Channel):
                    channels[record.id] = record.topic
                elif isinstance(record, Message):
                    yield channels[record.channel_id], record.log_time / 1e9, json.loads(record.data)
                elif isinstance(record, Metadata):
                    yield f"#{record.name}", 0.0, record.metadata
    except (CRCValidationError, ValueError, KeyError) as error:
        raise InputError(str(path), f"damaged: {error}", "a recording as it was written") from None
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "a recording, run.mcap") from None


def _next_whole(records: Iterator[Any]) -> Any:
    """The next record, or None at the end or where the file breaks off in the middle of one."""
    try:
        return next(records, None)
    except CRCValidationError:
        raise
    except (McapError, struct.error):
        return None


def read_recording(path: Path) -> Recording:
    """Read a run back, whole or cut short, without its images: `read_steps` has them, one step at a time.

    Raises:
        InputError: the file holds no mission, or not one whole step.
    """
    messages = read_messages(path)
    first = next(messages, None)
    if first is None or first[0] != "/mission":
        raise InputError(
            str(path),
            "not a recording of skyherd, or cut off at its very start",
            "a run.mcap of `skyherd run`",
        )
    mission = _read_mission(first[2])
    versions = {name: str(first[2].get(name, "?")) for name in ("version", "opencv", "numpy")}
    steps: list[Step] = []
    wall_s: float | None = None
    pending: dict[str, Any] = {}
    has_images = False
    for topic, time_s, record in messages:
        has_images |= topic.endswith("/image")
        if not topic.endswith("/image"):
            pending[topic] = record
        if topic == "/observer":
            steps.append(_read_step(time_s, pending))
            pending = {}
        elif topic == "#wall":
            wall_s = float(record["wall_s"])
    if not steps:
        raise InputError(str(path), "no whole step in it", "a run that went on for at least one chunk")
    return Recording(mission, versions, steps, wall_s, has_images)


def read_steps(path: Path) -> Iterator[Step]:
    """The steps of a recording with their images, one at a time."""
    pending: dict[str, Any] = {}
    for topic, time_s, record in read_messages(path):
        pending[topic] = record
        if topic == "/observer":
            yield _read_step(time_s, pending)
            pending = {}


def _read_mission(record: dict[str, Any]) -> Mission:
    return Mission(
        scenario=Scenario.model_validate(record["scenario"]),
        template=Template.from_image_points(record["template_ids"], record["template_px"]),
        ids=np.array(record["ids"], dtype=np.int64),
        positions_m=np.array(record["positions_m"], dtype=float),
        headings_rad=np.array(record["headings_rad"], dtype=float),
    )


def _read_step(time_s: float, records: dict[str, Any]) -> Step:
    units = sorted(int(topic.split("/")[2]) for topic in records if topic.endswith("/detections"))
    observer, world = records["/observer"], records["/world"]
    return Step(
        time_s=time_s,
        positions_m=np.array(world["positions_m"]),
        headings_rad=np.array(world["headings_rad"]),
        fleet=from_plain(Fleet, world["fleet"]),
        frames={unit: _read_frame(f"/unit/{unit}", records) for unit in units},
        command=from_plain(VelocityCommand, records["/robots/command"]),
        commanded_ids=np.array(observer["commanded_ids"], dtype=np.int64),
        control_sets={
            int(unit): np.array(ids, dtype=np.int64) for unit, ids in observer["control_sets"].items()
        },
        observation=from_plain(
            Observation,
            observer,
            conditions=Conditions(**observer["conditions"]),
            shape=ShapeFit(**observer["shape"]),
        ),
    )


def _read_frame(topic: str, records: dict[str, Any]) -> UnitFrame:
    truth, goals, image = (
        records[f"{topic}/truth"],
        records.get(f"{topic}/goals"),
        records.get(f"{topic}/image"),
    )
    sight = Sight(
        detections=from_plain(Detections, records[f"{topic}/detections"]),
        whole_ids=np.array(truth["whole_ids"], dtype=np.int64),
        found_ids=np.array(truth["found_ids"], dtype=np.int64),
        false_detections=truth["false_detections"],
        image=None if image is None else _decode(image["data"]),
    )
    decision = Decision(
        goals=None if goals is None else from_plain(MotionGoals, goals),
        report=from_plain(UnitReport, records[f"{topic}/report"]),
        flight=from_plain(FlightCommand, records[f"{topic}/flight"]),
    )
    return UnitFrame(sight, decision)


def _decode(data: str) -> Any:
    return cv2.imdecode(np.frombuffer(base64.b64decode(data), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
