"""Replay of a recording: decisions from the recorded inputs, compared bit by bit with the recorded ones."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyherd.errors import InputError
from skyherd.live.lab import Lab, make_lab
from skyherd.live.logs.process_log_file import check_format, read_process_log
from skyherd.live.robot_core import RobotCore
from skyherd.live.unit_core import UnitCore
from skyherd.live.wire import envelope_of
from skyherd.messages import Detections
from skyherd.recording.json_codec import from_plain, to_json


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes:
        name: of the process.
        decisions: number of its decisions.
        different: number of decisions that differ in the replay.
        first_s: time of the first different decision; None without one.
        ended: whether the process ended in order; otherwise up to 0.5 s may be missing at the end.
    """

    name: str
    decisions: int
    different: int
    first_s: float | None
    ended: bool


def replay(path: Path) -> Replayed:
    """Replay the recording of one process, and return the result.

    Raises:
        InputError: the file is not such a recording.
    """
    core: RobotCore | UnitCore | None = None
    name, decisions, different, first_s, ended = "", 0, 0, None, False
    pending: bytes | None = None
    for topic, record in read_process_log(path):
        if topic == "/about":
            if core is None:
                check_format(record, path)
                name = record["name"]
                lab = make_lab(record["lab"], where=str(path))
                options = {option: bool(record[option]) for option in ("supervised", "dry_run")}
                core = _core(name, lab, **options)
        elif core is None:
            break
        elif topic == "/heard":
            core.receive(envelope_of(record), record["received_s"])
        elif topic == "/heartbeat":
            core.heartbeat(record["now_s"], "")
        elif topic == "/detections" and isinstance(core, UnitCore):
            news = core.see(from_plain(Detections, record["detections"]), record["now_s"])
            pending = to_json(None if news is None else news.messages)
        elif topic == "/sent" or (topic == "/decide" and isinstance(core, RobotCore)):
            decisions += 1
            recorded = to_json(record["messages"] if topic == "/sent" else record["order"])
            replayed = pending if isinstance(core, UnitCore) else _decide(core, record)
            if recorded != replayed:
                different += 1
                first_s = record["now_s"] if first_s is None else first_s
        elif topic == "/end":
            ended = True
    if core is None:
        raise InputError(str(path), "no record of a live process", "a file of `skyherd live run`")
    return Replayed(name, decisions, different, first_s, ended)


def _decide(core: RobotCore, record: dict[str, Any]) -> bytes:
    """Return the order of a robot for a record of its decision."""
    return to_json(core.decide(record["now_s"], record["trouble"]))


def _core(name: str, lab: Lab, *, supervised: bool, dry_run: bool) -> RobotCore | UnitCore:
    kind, _, number = name.partition("/")
    if kind == "robot":
        return lab.make_robot(int(number), supervised=supervised, dry_run=dry_run)
    return lab.make_unit(int(number))
