"""Recordings read back: a run's mission and steps, up to where its file ends or breaks off."""

import base64
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import orjson
from mcap.exceptions import McapError
from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader
from pydantic import ValidationError
from zstandard import ZstdError

from skyherd.control import Conditions, Decision, GroundMap, Template, rectified
from skyherd.datasets import Mission, Scenario
from skyherd.errors import InputError
from skyherd.loop import Step, UnitFrame
from skyherd.messages import Detections, FlightCommand, MotionGoals, Proximity, UnitReport, VelocityCommand
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import TreeStatus
from skyherd.recording.json_codec import from_plain
from skyherd.sim.perception import Sight
from skyherd.sim.truth_metrics import ShapeFit, TruthMetrics
from skyherd.sim.world import Fleet


@dataclass(frozen=True)
class Recording:
    """A run read back.

    Attributes:
        mission: what was run.
        versions: versions of skyherd and of the libraries that ran it, by name.
        steps: all steps that are whole in the file, without camera images.
        wall_s: wall time of the run, None if it was cut short.
        has_images: whether camera images were recorded; `read_steps` has them.
    """

    mission: Mission
    versions: dict[str, str]
    steps: list[Step]
    wall_s: float | None
    has_images: bool


def read_messages(path: Path) -> Iterator[tuple[str, float, Any]]:
    """Iterate over the topic, the time (s) and the content of each message, up to where the file breaks off.

    A record of metadata has the topic `#name` and time 0. The topics are listed in
    `skyherd.recording.writer`.

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
                    yield channels[record.channel_id], record.log_time / 1e9, orjson.loads(record.data)
                elif isinstance(record, Metadata):
                    yield f"#{record.name}", 0.0, record.metadata
    except (CRCValidationError, ZstdError, ValueError, KeyError) as error:
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
    """Read a run back, whole or cut short, without its images, which `read_steps` has one step at a time.

    Raises:
        InputError: the file holds no mission, or not one whole step, or is of another version of skyherd.
    """
    mission: Mission | None = None
    wall_s: float | None = None
    versions: dict[str, str] = {}
    steps: list[Step] = []
    pending: dict[str, Any] = {}
    has_images = ended = False
    for topic, time_s, record in read_messages(path):
        # Metadata of the wall time may precede the last chunk: /end alone says that the run is whole.
        ended |= topic == "/end"
        has_images |= topic.endswith("/image")
        if topic == "#wall":
            wall_s = float(record["wall_s"])
        elif mission is None:
            if topic != "/mission":
                break
            versions = {name: str(record.get(name, "?")) for name in ("version", "opencv", "numpy")}
            with _version_checked(path):
                mission = _read_mission(record)
        elif topic == "/metrics":
            with _version_checked(path):
                steps.append(_read_step(time_s, pending | {topic: record}))
            pending = {}
        elif not topic.endswith("/image"):
            pending[topic] = record
    if mission is None:
        raise InputError(
            str(path),
            "not a recording of skyherd, or cut off at its very start",
            "a run.mcap of `skyherd run`",
        )
    if not steps:
        raise InputError(str(path), "no whole step in it", "a run that went on for at least one chunk")
    return Recording(
        mission=mission,
        versions=versions,
        steps=steps,
        wall_s=wall_s if ended else None,
        has_images=has_images,
    )


def read_steps(path: Path) -> Iterator[Step]:
    """Iterate over the steps of a recording with their camera images, which are too large to keep all.

    Raises:
        InputError: there is no such file, or it is damaged within.
    """
    pending: dict[str, Any] = {}
    for topic, time_s, record in read_messages(path):
        pending[topic] = record
        if topic == "/metrics":
            yield _read_step(time_s, pending)
            pending = {}


@contextmanager
def _version_checked(path: Path) -> Iterator[None]:
    """Turn the errors of records that another version wrote into an InputError of one line."""
    try:
        yield
    except (KeyError, TypeError, ValueError) as error:  # pydantic's and our messages' errors too
        first = error.errors()[0] if isinstance(error, ValidationError) else None
        at = ".".join(str(part) for part in first["loc"]) + f": {first['msg']}" if first else str(error)
        raise InputError(
            str(path),
            f"recorded by another version of skyherd ({at})",
            "`skyherd run` again, or the version that made it",
        ) from None


def _read_mission(record: dict[str, Any]) -> Mission:
    return Mission(
        scenario=Scenario.model_validate(record["scenario"]),
        template=Template.from_image_points(record["template_ids"], record["template_px"]),
        ids=np.array(record["ids"], dtype=np.int64),
        positions_m=np.array(record["positions_m"], dtype=float),
        headings_rad=np.array(record["headings_rad"], dtype=float),
        later=tuple(
            (later["at_s"], Template.from_image_points(record["template_ids"], later["template_px"]))
            for later in record["later"]
        ),
    )


def _read_step(time_s: float, records: dict[str, Any]) -> Step:
    units = sorted(int(topic.split("/")[2]) for topic in records if topic.endswith("/detections"))
    observer, world = records["/metrics"], records["/world"]
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
        metrics=from_plain(
            TruthMetrics,
            observer,
            conditions=Conditions(**observer["conditions"]),
            shape=ShapeFit(**observer["shape"]),
        ),
        roles=np.array(observer["roles"], dtype=np.int64),
    )


def _read_frame(topic: str, records: dict[str, Any]) -> UnitFrame:
    truth, goals, image, near = (
        records[f"{topic}/truth"],
        records.get(f"{topic}/goals"),
        records.get(f"{topic}/image"),
        records.get(f"{topic}/proximity"),
    )
    sight = Sight(
        detections=from_plain(Detections, records[f"{topic}/detections"]),
        whole_ids=np.array(truth["whole_ids"], dtype=np.int64),
        found_ids=np.array(truth["found_ids"], dtype=np.int64),
        false_detections=truth["false_detections"],
        image=None if image is None else _decode(image["data"]),
    )
    recorded_map = records.get(f"{topic}/map")
    ground_map = GroundMap() if recorded_map is None else from_plain(GroundMap, recorded_map)
    decision = Decision(
        detections=rectified(sight.detections, ground_map),
        goals=None if goals is None else from_plain(MotionGoals, goals),
        report=_read_report(records[f"{topic}/report"]),
        flight=from_plain(FlightCommand, records[f"{topic}/flight"]),
        proximity=None if near is None else from_plain(Proximity, near),
        ground_map=ground_map,
    )
    return UnitFrame(sight, decision)


def _read_report(record: dict[str, Any]) -> UnitReport:
    tree, roles = record.get("tree"), record.get("roles")
    return from_plain(
        UnitReport,
        record,
        tree=None if tree is None else from_plain(TreeStatus, tree),
        roles=None if roles is None else from_plain(RoleMap, roles),
    )


def _decode(data: str) -> Any:
    return cv2.imdecode(np.frombuffer(base64.b64decode(data), dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
