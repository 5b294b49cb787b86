"""Decides anew from what a process recorded, and compares what comes out with what it did, bit for bit."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyherd.errors import InputError
from skyherd.live.lab import make_lab
from skyherd.live.logs.process_log_file import check_format, read_process_log
from skyherd.live.robot_core import RobotCore
from skyherd.live.unit_core import UnitCore
from skyherd.live.wire import envelope_of
from skyherd.messages import Detections
from skyherd.recording.json_codec import from_plain, to_json


@dataclass(frozen=True)
class Replayed:
    """What came of deciding anew.

    Attributes:
        name: of the process.
        decisions: how many it made.
        different: how many of them came out differently.
        first_s: when the first of those was made; None if there is none.
        ended: whether the process ended as it should; otherwise the file ends up to half a second early.
    """

    name: str
    decisions: int
    different: int
    first_s: float | None
    ended: bool


def replay(path: Path) -> Replayed:
    """Decide anew from one process's file.

    Raises:
        InputError: it is no such file.
    """
    core: RobotCore | UnitCore | None = None
    name, decisions, different, first_s, ended = "", 0, 0, None, False
    pending: bytes | None = None
    for topic, record in read_process_log(path):
        if topic == "/about":
            if core is None:
                check_format(record, path)
                name = record["name"]
                core = _core(name, make_lab(record["lab"], where=str(path)))
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
            was = to_json(record["messages"] if topic == "/sent" else record["order"])
            now = pending if isinstance(core, UnitCore) else to_json(core.decide(record["now_s"]))
            if was != now:
                different += 1
                first_s = record["now_s"] if first_s is None else first_s
        elif topic == "/end":
            ended = True
    if core is None:
        raise InputError(str(path), "nothing of a live process in it", "a file of `skyherd live run`")
    return Replayed(name, decisions, different, first_s, ended)


def _core(name: str, lab: Any) -> RobotCore | UnitCore:
    kind, _, number = name.partition("/")
    if kind == "robot":
        robot: RobotCore = lab.make_robot(int(number))
        return robot
    unit: UnitCore = lab.make_unit(int(number))
    return unit
