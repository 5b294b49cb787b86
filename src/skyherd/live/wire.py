"""The wire format: messages in envelopes, and the validation of incoming bytes.

An envelope is a JSON object with ten keys: the version of the format, the team, the sender's name and
instance, the time of sending by the sender's clock, the two numbers of its latch
(`skyherd.live.stop_latch`), the kind of the message, and the message itself as it is recorded.
Incoming bytes become a message only if team, version, kind, shape and sender fit. Everything else is refused
with a reason, never with an exception.

    unit/J   goals, proximity, report, sighting, heartbeat, and flight where the world is simulated
    robot/I  heartbeat, and wheels where the world is simulated
    any      heartbeat, arm, stop
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

import orjson

from skyherd.errors import MessageError
from skyherd.geometry import IntArray
from skyherd.live.stop_latch import MAX_STOP, NO_COMMAND, StopLatch
from skyherd.messages import FlightCommand, MotionGoals, Proximity, UnitReport
from skyherd.messages.checks import check_time
from skyherd.messages.frozen_arrays import freeze_ids
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import TreeStatus
from skyherd.recording.json_codec import from_plain, to_json
from skyherd.text import printable, shorten

VERSION = 3
"""Version of the format. It rises whenever a message changes in a way that an older process would misread."""

MAX_BYTES = 1 << 20
"""Size of the largest message that is looked at. Chosen: goals of a thousand robots with three neighbours
each take a quarter of it."""

MAX_NAME = 40
"""Length of the longest name of a process. Chosen: a few times the longest that is used."""

LATEST_S = 1e10
"""Largest stamp that is taken for a time, s. Chosen: three centuries after 1970; sums of such stay exact to a
microsecond or two."""


@dataclass(frozen=True)
class Sighting:
    """Which markers one image showed.

    Attributes:
        unit_id: the unit whose image it is.
        time_s: when it was taken.
        ids: (N,) markers that were found once.
        repeated_ids: (M,) markers that were found at several places, so that nobody knows which is the robot.

    Raises:
        MessageError: an id is negative or occurs twice, or the time is no number.
    """

    unit_id: int
    time_s: float
    ids: IntArray
    repeated_ids: IntArray

    def __post_init__(self) -> None:
        check_time(self)
        freeze_ids(self, "ids")
        freeze_ids(self, "repeated_ids")


@dataclass(frozen=True)
class Heartbeat:
    """A sign of life, by which clocks are compared as well.

    Attributes:
        heard: by process, the stamp of sending of its last message, by its clock, and when that arrived, by
            the sender's.
        state: what the process says of itself, for people.
        session: of a robot, what an arm command has to name; changes with each stop. Empty for others.
        armed: of a robot, whether its wheels may turn.
        ready: of a robot, whether it would accept an arm command now.
    """

    heard: Mapping[str, tuple[float, float]]
    state: str = ""
    session: str = ""
    armed: bool = False
    ready: bool = False


@dataclass(frozen=True)
class Arm:
    """Arms the robots that are named with their current session, and clears the stop that the envelope names.

    A command that was under way while a robot stopped or restarted names an old session, and does nothing.

    Attributes:
        sessions: by process name of a robot, its session.
    """

    sessions: Mapping[str, str]


@dataclass(frozen=True)
class Stop:
    """Stops and disarms all robots. Its number is the envelope's stop number.

    Attributes:
        why: who asked for it, for people.
    """

    why: str


@dataclass(frozen=True)
class Wheels:
    """What a robot's driver tells the wheels of a simulated world.

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
            raise MessageError("Wheels: v_mps and omega_radps must be finite")


Message = MotionGoals | Proximity | UnitReport | Sighting | Heartbeat | Arm | Stop | Wheels | FlightCommand
"""Everything that goes over the radio."""

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
"""Kinds of messages by their names on the wire, which also end their topics."""

KIND_OF = {kind: name for name, kind in KINDS.items()}
"""The names by kind."""


@dataclass(frozen=True)
class Envelope:
    """A message with its sender, its time and the sender's latch.

    Attributes:
        sender: name of the process that sent it, such as `unit/0`.
        sent_s: when it was sent, by the sender's clock.
        message: the message.
        instance: random id of the sending process, which differs between two processes of one name.
        latch: the commands that the sender knows of.
    """

    sender: str
    sent_s: float
    message: Message
    instance: str = ""
    latch: StopLatch = NO_COMMAND

    @property
    def kind(self) -> str:
        """Name of the kind of the message."""
        return KIND_OF[type(self.message)]


class Refused(Exception):
    """Bytes that are no message for us; the text says why in a few words."""


class Refusals:
    """Counts refused messages by reason, and says each reason once.

    Attributes:
        counts: by reason.
        most: number of reasons that are told apart; all others are counted as one, so that garbage from
            outside fills no memory.
    """

    def __init__(self, most: int = 32) -> None:
        self.counts: dict[str, int] = {}
        self.most = most

    def refuse(self, why: str) -> str | None:
        """Count one more; returns the reason as a line the first time, and None from then on."""
        why = why if why in self.counts or len(self.counts) < self.most else "for yet other reasons"
        self.counts[why] = self.counts.get(why, 0) + 1
        return why if self.counts[why] == 1 else None


def envelope_record(envelope: Envelope) -> dict[str, Any]:
    """Return an envelope as the object that is sent and recorded."""
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
    """Return the envelope of an object of `envelope_record`, its message as a plain object.

    Raises:
        MessageError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError: it is none.
    """
    latch = StopLatch(_stop_number(record["stop"]), _stop_number(record["cleared"]))
    if latch.cleared == MAX_STOP:
        raise ValueError("no stop number is left")
    message = plain_message(record["kind"], record["body"])
    return Envelope(str(record["sender"]), float(record["sent_s"]), message, str(record["instance"]), latch)


def encode(envelope: Envelope, team: str) -> bytes:
    """Return the bytes of an envelope."""
    return to_json({"version": VERSION, "team": team} | envelope_record(envelope))


def decode(data: bytes, team: str) -> Envelope:
    """The envelope of bytes that arrived.

    Raises:
        Refused: they are too many, no JSON, of another team or version, or no message of ours.
    """
    if len(data) > MAX_BYTES:
        raise Refused("larger than a message can be")
    try:
        record = orjson.loads(data)
    except (orjson.JSONDecodeError, RecursionError):
        raise Refused("not JSON") from None
    if not isinstance(record, dict) or not isinstance(record.get("team"), str):
        raise Refused("no message of skyherd")
    if record["team"] != team:
        raise Refused(f"of another team, {_shown(record['team'])}")
    if record.get("version") != VERSION or isinstance(record["version"], bool):
        raise Refused(f"of format {_shown(str(record.get('version')))}, here it is {VERSION}")
    sender, sent_s, kind = record.get("sender"), record.get("sent_s"), record.get("kind")
    if not isinstance(sender, str) or not 0 < len(sender) <= MAX_NAME:
        raise Refused("from nobody in particular")
    if not is_stamp(sent_s):
        raise Refused("without a time of sending")
    instance = record.get("instance")
    if not isinstance(instance, str) or len(instance) > MAX_NAME:
        raise Refused(f"without an instance from {_shown(sender)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise Refused(f"of an unknown kind from {_shown(sender)}")
    try:
        envelope = envelope_of(record)
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError, RuntimeWarning):
        raise Refused(f"{kind} of a wrong shape from {_shown(sender)}") from None
    unit, robot = getattr(envelope.message, "unit_id", None), getattr(envelope.message, "robot_id", None)
    expected = f"unit/{unit}" if unit is not None else None if robot is None else f"robot/{robot}"
    if expected is not None and sender != expected:
        raise Refused(f"{kind} in another's name from {_shown(sender)}")
    return envelope


def is_stamp(value: Any) -> TypeGuard[float]:
    """Whether a plain value is a time that a clock can show."""
    return isinstance(value, int | float) and not isinstance(value, bool) and -LATEST_S < value < LATEST_S


def _shown(text: str) -> str:
    return repr(shorten(printable(text), 30))


def plain_message(name: str, body: Any) -> Message:
    """A message of a kind of `KINDS` from its plain object.

    Raises:
        MessageError, ValueError, TypeError, KeyError, AttributeError, IndexError, OverflowError: it is none.
    """
    kind = KINDS[name]
    if not isinstance(body, dict):
        raise TypeError("no object")
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
        return from_plain(Heartbeat, body, heard=heard)
    if kind is Arm:
        return Arm({_name(robot): _name(session) for robot, session in body["sessions"].items()})
    message: Message = from_plain(kind, body)
    return message


def _name(value: Any) -> str:
    if not isinstance(value, str) or len(value) > 100:
        raise TypeError("no name")
    return value


def _stop_number(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_STOP:
        raise ValueError("no stop number")
    return value


def _stamps(pair: Any) -> tuple[float, float]:
    if not isinstance(pair, list) or len(pair) != 2 or not all(is_stamp(value) for value in pair):
        raise ValueError("no pair of stamps")
    return float(pair[0]), float(pair[1])
