"""The radio as processes see it, and a radio in memory for tests of its faults.

A radio carries bytes under topics and promises nothing: messages are lost, late, repeated or reordered. A
`Mailbox` puts the messages of one process into envelopes and validates those that arrive.
"""

import queue
import secrets
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Protocol

from skyherd.live.stop_latch import StopLatch
from skyherd.live.wire import Envelope, Message, Refusals, Refused, decode, encode

MAX_WAITING = 5000
"""Messages that wait for a process at most; later ones are dropped, and counted. Chosen: ten seconds of a
team of twenty; a process that is slower than its radio had better miss news than steer by old ones."""


class Radio(Protocol):
    """Carries bytes between processes under topics such as `skyherd/TEAM/goals/unit/0`."""

    def publish(self, topic: str, data: bytes) -> None:
        """Send to all that listen now; never waits, and may be lost."""

    def subscribe(self, pattern: str, take: Callable[[bytes], None]) -> None:
        """Call `take` with all that comes under a pattern, in which `*` is one part and `**` any number.

        It may be called from another thread, and must return soon. A radio may give a process what it sent
        itself.
        """

    def close(self) -> None:
        """End all of it."""


@dataclass(frozen=True)
class Arrival:
    """A message at the instant at which it arrived.

    Attributes:
        envelope: the message.
        received_s: when it arrived, by this process's clock.
    """

    envelope: Envelope
    received_s: float


class Mailbox:
    """The messages of one process: outgoing ones get an envelope, incoming ones are validated.

    Messages of its own are left out. Those that another process sends under the same name arrive, with an
    `instance` that differs.

    Attributes:
        name: of the process, such as `unit/0`.
        instance: random id of this process.
        refusals: what was refused, by reason.
        dropped: messages that were dropped since the process did not fetch them in time.

    Args:
        radio: what carries the bytes.
        team: messages of other teams are refused.
        name: as the attribute.
        clock: gives the time, s.
        kinds: topics to listen to, after the team's name: `goals/**`.
        tell: called with a line, the first time that something is refused for a reason.
        latch: returns the commands that the process knows of, for every message that it sends.
    """

    def __init__(
        self,
        radio: Radio,
        team: str,
        name: str,
        clock: Callable[[], float],
        kinds: Sequence[str],
        tell: Callable[[str], None] = lambda line: None,
        latch: Callable[[], StopLatch] = StopLatch,
    ) -> None:
        self.name, self.refusals, self.dropped = name, Refusals(), 0
        self.instance = secrets.token_hex(4)
        self._latch = latch
        self._radio, self._team, self._clock, self._tell = radio, team, clock, tell
        self._waiting: queue.Queue[tuple[bytes, float]] = queue.Queue(MAX_WAITING)
        for kind in kinds:
            radio.subscribe(f"skyherd/*/{kind}", self._take)

    def send(self, message: Message) -> Envelope:
        """Send a message to all listeners, and return its envelope."""
        envelope = Envelope(self.name, self._clock(), message, self.instance, self._latch())
        topic = f"skyherd/{self._team}/{envelope.kind}/{self.name}"
        self._radio.publish(topic, encode(envelope, self._team))
        return envelope

    def fetch(self, timeout_s: float = 0.0) -> Iterator[Arrival]:
        """Yield the messages that have arrived, in order; wait for the first one up to `timeout_s`."""
        wait = timeout_s > 0
        while True:
            try:
                data, received_s = self._waiting.get(block=wait, timeout=timeout_s if wait else None)
            except queue.Empty:
                return
            wait = False
            try:
                envelope = decode(data, self._team)
            except Refused as error:
                if line := self.refusals.refuse(str(error)):
                    self._tell(f"refused a message {line}" if " " in line else line)
                continue
            if (envelope.sender, envelope.instance) != (self.name, self.instance):
                yield Arrival(envelope, received_s)

    def _take(self, data: bytes) -> None:
        try:
            self._waiting.put_nowait((data, self._clock()))
        except queue.Full:
            self.dropped += 1


def matches(pattern: str, topic: str) -> bool:
    """Whether a topic is under a pattern, in which `*` is one part and `**` any number of them."""
    return _matches(pattern.split("/"), topic.split("/"))


def _matches(pattern: list[str], parts: list[str]) -> bool:
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(_matches(pattern[1:], parts[skip:]) for skip in range(len(parts) + 1))
    return bool(parts) and pattern[0] in ("*", parts[0]) and _matches(pattern[1:], parts[1:])


@dataclass
class Air:
    """What memory radios share: who hears whom, how late, and what gets lost.

    Attributes:
        drop: decides for a topic and a receiver whether a message is lost.
        delay_s: tells for a topic and a receiver how late it is.
        now_s: the time, which only `advance` moves.
    """

    drop: Callable[[str, str], bool] = lambda topic, receiver: False
    delay_s: Callable[[str, str], float] = lambda topic, receiver: 0.0
    now_s: float = 0.0
    _radios: list["MemoryRadio"] = field(default_factory=list)
    _under_way: list[tuple[float, int, Callable[[bytes], None], bytes]] = field(default_factory=list)
    _count: int = 0

    def radio(self, name: str) -> "MemoryRadio":
        """A new radio of the process of this name."""
        self._radios.append(MemoryRadio(self, name))
        return self._radios[-1]

    def advance(self, now_s: float) -> None:
        """Let time pass: what is due by then arrives, in order."""
        while self._under_way and self._under_way[0][0] <= now_s:
            self.now_s, _, take, data = heappop(self._under_way)
            take(data)
        self.now_s = now_s

    def carry(self, topic: str, data: bytes) -> None:
        """Send a message on its way to everybody who listens."""
        for radio in self._radios:
            for pattern, take in radio.listeners:
                if matches(pattern, topic) and not self.drop(topic, radio.name):
                    self._count += 1
                    due_s = self.now_s + self.delay_s(topic, radio.name)
                    heappush(self._under_way, (due_s, self._count, take, data))

    def leave(self, radio: "MemoryRadio") -> None:
        """A radio is closed."""
        self._radios.remove(radio)


class MemoryRadio(Radio):
    """A radio whose messages cross an `Air`.

    Attributes:
        name: of its process, by which the air's rules know it.
        listeners: patterns, and who listens to them.
    """

    def __init__(self, air: Air, name: str) -> None:
        self.name = name
        self.listeners: list[tuple[str, Callable[[bytes], None]]] = []
        self._air = air

    def publish(self, topic: str, data: bytes) -> None:
        """Send to all that listen now."""
        self._air.carry(topic, data)

    def subscribe(self, pattern: str, take: Callable[[bytes], None]) -> None:
        """Call `take` with all that arrives under a pattern."""
        self.listeners.append((pattern, take))

    def close(self) -> None:
        """Hear nothing any more."""
        self._air.leave(self)
