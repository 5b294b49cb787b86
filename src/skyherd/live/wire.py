"""The wire format: messages in envelopes, and validation of received bytes.

An envelope is a JSON object with nine keys:

- `version`: version of the format;
- `team`: name of the team;
- `sender`, `instance`: name and random id of the sending process;
- `sent_s`: time of sending on the sender's clock;
- `stop`, `cleared`: numbers of the sender's latch (`skyherd.live.stop_latch`);
- `kind`, `body`: kind of the message, and the message as it is recorded.

Bytes become a message only if team, version, kind, shape, ranges and sender are valid. All other bytes are
refused with a reason.

    unit/J   goals, proximity, report, sighting, heartbeat, and flight in a simulated world
    robot/I  heartbeat, and wheels in a simulated world
    any      heartbeat, arm, stop
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

import orjson

from skyherd.errors import MessageError
from skyherd.live.plausible import check_ranges
from skyherd.live.stop_latch import MAX_STOP, NO_COMMAND, NOT_HALTED, StopLatch
from skyherd.messages import FlightCommand, MotionGoals, Proximity, Sighting, UnitReport
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import TreeStatus
from skyherd.recording.json_codec import from_plain, to_json
from skyherd.text import printable, shorten

VERSION = 5
"""Version of the format. It increases with every change that an older process would misread."""

MAX_BYTES = 1 << 18
"""Size of the largest accepted message, bytes. Chosen: the largest message is a proximity. That of 150 robots
with 18 bodies around each has 230 kB. A heartbeat about `MAX_PEERS` processes has 165 kB."""

TOO_LARGE = "larger than the largest message"
"""Reason of a refusal."""

MAX_NAME = 40
"""Length of the longest process name, characters. Chosen: a few times the longest one in use."""

LATEST_S = 1e10
"""Largest valid time stamp, s. Chosen: three centuries after 1970. Sums of two stamps stay exact to about two
microseconds."""


@dataclass(frozen=True)
class Heartbeat:
    """A periodic message that shows that a process is alive, and serves the comparison of clocks.

    Attributes:
        heard: by process, the two times of its last message: sent on its clock, received on the sender's.
        state: status text of the process, for people.
        session: session of a robot, which an arm command must name; empty for other processes.
        armed: whether the robot is armed.
        ready: whether the robot would accept an arm command now.
        lab: digest of the lab file of the process (`skyherd.live.lab.Lab.digest`); empty if it has none.
        halted: largest stop number that the robot knew when its link last took a zero, with neither an error
            nor another motion since; `NOT_HALTED` otherwise.
    """

    heard: Mapping[str, tuple[float, float]]
    state: str = ""
    session: str = ""
    armed: bool = False
    ready: bool = False
    lab: str = ""
    halted: int = NOT_HALTED


@dataclass(frozen=True)
class Arm:
    """Command that arms the robots named with their current session, and clears the envelope's stop.

    A command sent before a robot stopped or restarted names an old session, and has no effect.

    Attributes:
        sessions: session of each robot, by its process name.
    """

    sessions: Mapping[str, str]


@dataclass(frozen=True)
class Stop:
    """Command that stops and disarms all robots. Its number is the envelope's stop number.

    Attributes:
        why: origin of the command, for people.
    """

    why: str


@dataclass(frozen=True)
class Wheels:
    """Wheel command of a robot in a simulated world.

    Attributes:
        robot_id: the robot.
        v_mps: forward speed.
        omega_radps: turn rate, counter-clockwise from above.
    """

    robot_id: int
    v_mps: float
    omega_radps: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.v_mps) or not math.isfinite(self.omega_radps):
            raise MessageError("Wheels", f"{self.v_mps}, {self.omega_radps}", "finite v_mps and omega_radps")


Message = MotionGoals | Proximity | UnitReport | Sighting | Heartbeat | Arm | Stop | Wheels | FlightCommand
"""All messages sent by radio."""

KINDS: Mapping[str, type] = {
    "goals": MotionGoals,
    "proximity": Proximity,
    "report": UnitReport,
    "sighting": Sighting,
    "heartbeat": Heartbeat,
    "arm": Arm,
    "stop": Stop,
    "wheels": Wheels,
    "flight": FlightCommand,
}
"""Message classes by kind name, which is also part of the topic."""

KIND_OF = {kind: name for name, kind in KINDS.items()}
"""Kind names by message class."""


@dataclass(frozen=True)
class Envelope:
    """A message with its sender, time of sending and latch.

    Attributes:
        sender: name of the sending process, such as `unit/0`.
        sent_s: time of sending on the sender's clock.
        message: the message.
        instance: random id of the sending process, which differs between two processes of one name.
        latch: commands known to the sender.
    """

    sender: str
    sent_s: float
    message: Message
    instance: str = ""
    latch: StopLatch = NO_COMMAND

    @property
    def kind(self) -> str:
        """Kind name of the message."""
        return KIND_OF[type(self.message)]


SESSION = "session"
"""Process name of `live run`, which runs all processes of a lab on its machine."""


class Refused(Exception):
    """Error for received bytes that are not a valid message. Its text is the reason."""


class OutOfRange(MessageError):
    """Error for a message of the right shape with a value that no process sends."""


class Refusals:
    """Counter of refused messages by reason, which reports each reason once.

    Attributes:
        counts: number of messages by reason.
        most: largest number of separate reasons. Further reasons share one count, which bounds the memory.
    """

    def __init__(self, most: int = 32) -> None:
        self.counts: dict[str, int] = {}
        self.most = most

    def refuse(self, why: str) -> str | None:
        """Count a refusal. Return the reason the first time, and None from then on."""
        why = why if why in self.counts or len(self.counts) < self.most else "for further reasons"
        self.counts[why] = self.counts.get(why, 0) + 1
        return why if self.counts[why] == 1 else None


def envelope_record(envelope: Envelope) -> dict[str, Any]:
    """Return an envelope as the JSON object that is sent and recorded."""
    return {
        "sender": envelope.sender,
        "instance": envelope.instance,
        "sent_s": envelope.sent_s,
        "stop": envelope.latch.stop,
        "cleared": envelope.latch.cleared,
        "kind": envelope.kind,
        "body": envelope.message,
    }


def envelope_of(record: Mapping[str, Any]) -> Envelope:
    """Return the envelope of an object of `envelope_record`, with its message as a plain object.

    Raises:
        MessageError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError: it is not
            a valid envelope.
    """
    latch = StopLatch(_stop_number(record["stop"]), _stop_number(record["cleared"]))
    if latch.cleared == MAX_STOP:
        raise ValueError("cleared is above all stop numbers")
    message = plain_message(record["kind"], record["body"])
    try:
        check_ranges(message)
    except MessageError as error:
        raise OutOfRange(error.where, error.what, error.allowed) from None
    return Envelope(str(record["sender"]), float(record["sent_s"]), message, str(record["instance"]), latch)


def encode(envelope: Envelope, team: str) -> bytes:
    """Return the bytes of an envelope."""
    return to_json({"version": VERSION, "team": team} | envelope_record(envelope))


def decode(data: bytes, team: str) -> Envelope:
    """Return the envelope encoded in received bytes.

    Raises:
        Refused: the bytes are too many, not JSON, of another team or version, or not a valid message.
    """
    if len(data) > MAX_BYTES:
        raise Refused(TOO_LARGE)
    try:
        record = orjson.loads(data)
    except (orjson.JSONDecodeError, RecursionError):
        raise Refused("not JSON") from None
    if not isinstance(record, dict) or not isinstance(record.get("team"), str):
        raise Refused("not a message of skyherd")
    if record["team"] != team:
        raise Refused(f"of another team, {_shown(record['team'])}")
    if record.get("version") != VERSION or isinstance(record["version"], bool):
        raise Refused(f"of format {_shown(str(record.get('version')))}, not {VERSION}")
    sender, sent_s, kind = record.get("sender"), record.get("sent_s"), record.get("kind")
    if not isinstance(sender, str) or not 0 < len(sender) <= MAX_NAME:
        raise Refused("without a valid sender")
    if not is_stamp(sent_s):
        raise Refused("without a time of sending")
    instance = record.get("instance")
    if not isinstance(instance, str) or len(instance) > MAX_NAME:
        raise Refused(f"without an instance from {_shown(sender)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise Refused(f"of an unknown kind from {_shown(sender)}")
    try:
        envelope = envelope_of(record)
    except OutOfRange as error:
        raise Refused(f"{kind} with {error.where} outside {error.allowed} from {_shown(sender)}") from None
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, RuntimeWarning):
        raise Refused(f"{kind} of a wrong shape from {_shown(sender)}") from None
    unit, robot = getattr(envelope.message, "unit_id", None), getattr(envelope.message, "robot_id", None)
    expected = f"unit/{unit}" if unit is not None else None if robot is None else f"robot/{robot}"
    if expected is not None and sender != expected:
        raise Refused(f"{kind} for another process from {_shown(sender)}")
    return envelope


def is_stamp(value: Any) -> TypeGuard[float]:
    """Return whether a plain value is a valid time stamp."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -LATEST_S < value < LATEST_S


def _shown(text: str) -> str:
    return repr(shorten(printable(text), 30))


def plain_message(name: str, body: Any) -> Message:
    """Return the message of a kind of `KINDS` from its plain object.

    Raises:
        MessageError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError: it is not
            a valid message of this kind.
    """
    kind = KINDS[name]
    if not isinstance(body, dict):
        raise TypeError("not an object")
    if "time_s" in body and not is_stamp(body["time_s"]):
        raise ValueError("time_s")
    if kind is UnitReport:
        tree, roles = body.get("tree"), body.get("roles")
        return from_plain(
            UnitReport,
            body,
            tree=None if tree is None else from_plain(TreeStatus, tree),
            roles=None if roles is None else from_plain(RoleMap, roles),
        )
    if kind is Heartbeat:
        heard = {_name(who): _stamps(when) for who, when in body["heard"].items()}
        _name(body["lab"])
        return from_plain(Heartbeat, body, heard=heard)
    if kind is Arm:
        return Arm({_name(robot): _name(session) for robot, session in body["sessions"].items()})
    message: Message = from_plain(kind, body)
    return message


def _name(value: Any) -> str:
    if not isinstance(value, str) or len(value) > 100:
        raise TypeError("not a name")
    return value


def _stop_number(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_STOP:
        raise ValueError("not a stop number")
    return value


def _stamps(pair: Any) -> tuple[float, float]:
    if not isinstance(pair, list) or len(pair) != 2 or not all(is_stamp(value) for value in pair):
        raise ValueError("not a pair of time stamps")
    return float(pair[0]), float(pair[1])
