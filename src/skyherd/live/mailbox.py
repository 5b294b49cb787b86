"""Radio interface of the processes, and an in-memory radio for tests of message loss and latency.

A radio carries bytes under topics without any guarantee: messages are lost, late, repeated or reordered. A
`Mailbox` puts the messages of one process into envelopes and validates incoming ones.
"""

import queue
import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Protocol

from skyherd.live.stop_latch import StopLatch
from skyherd.live.wire import MAX_BYTES, TOO_LARGE, Envelope, Message, Refusals, Refused, decode, encode

MAX_WAITING = 5000
"""Size of the receive queue, messages; further ones are dropped and counted. Chosen: ten seconds of traffic
of a team of twenty. A process slower than its radio loses messages instead of acting on stale ones."""

MAX_WAITING_BYTES = 1 << 22
"""Size of the receive queue, bytes; further messages are dropped and counted. Chosen: 16 messages of the
largest size, which take 0.15 s to read. A small message, such as a stop, fits where a large one does not."""

MAX_ROUND_S = 0.02
"""Longest time for which `Mailbox.fetch` yields messages, s. Chosen: a fifth of a robot's usual period."""


class Radio(Protocol):
    """Transport of bytes between processes, under topics such as `skyherd/TEAM/goals/unit/0`."""

    def publish(self, topic: str, data: bytes) -> None:
        """Send bytes to all current subscribers, without blocking. The message may be lost."""

    def subscribe(self, pattern: str, take: Callable[[bytes], None]) -> None:
        """Call `take` with each message whose topic matches a pattern.

        In a pattern, `*` matches one part and `**` any number of parts. `take` may run in another thread and
        must return quickly. A radio may deliver a process's own messages to it.
        """

    def close(self) -> None:
        """Close the radio and all its subscriptions."""


@dataclass(frozen=True)
class Arrival:
    """A received message with its time of arrival.

    Attributes:
        envelope: the message.
        received_s: time of arrival by this process's clock.
    """

    envelope: Envelope
    received_s: float


class Mailbox:
    """Outgoing and incoming messages of one process: it adds envelopes, and validates received bytes.

    The mailbox skips the process's own messages. It delivers messages that another process sends under the
    same name; their `instance` differs.

    Attributes:
        name: of the process, such as `unit/0`.
        instance: random id of this process.
        refusals: counts of refused messages by reason.
        dropped: number of messages dropped because the queue was full, in messages or in bytes.

    Args:
        radio: carries the bytes.
        team: messages of other teams are refused.
        name: as the attribute.
        clock: returns the time, s.
        kinds: topics to listen to, after the team's name: `goals/**`.
        tell: called with a line for the first refusal of each reason.
        latch: returns the known commands, which every sent message carries.
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
        self._waiting_bytes = self._too_large = 0
        self._lock = threading.Lock()
        for kind in kinds:
            radio.subscribe(f"skyherd/*/{kind}", self._take)

    def send(self, message: Message) -> Envelope:
        """Send a message to all subscribers, and return its envelope."""
        envelope = Envelope(self.name, self._clock(), message, self.instance, self._latch())
        topic = f"skyherd/{self._team}/{envelope.kind}/{self.name}"
        self._radio.publish(topic, encode(envelope, self._team))
        return envelope

    def fetch(self, timeout_s: float = 0.0) -> Iterator[Arrival]:
        """Yield the received messages in order. Wait up to `timeout_s` for the first one.

        Messages that arrive after the first was yielded are left to the next call, and so are those that wait
        after `MAX_ROUND_S`. A flood of messages therefore does not hold the caller.
        """
        begun_s: float | None = None
        for number in range(max(self._waiting.qsize(), 1)):
            wait = number == 0 and timeout_s > 0
            if begun_s is not None and not 0 <= self._clock() - begun_s <= MAX_ROUND_S:
                return
            try:
                data, received_s = self._waiting.get(block=wait, timeout=timeout_s if wait else None)
            except queue.Empty:
                return
            finally:
                self._refuse_large()
            begun_s = self._clock() if begun_s is None else begun_s
            with self._lock:
                self._waiting_bytes -= len(data)
            try:
                envelope = decode(data, self._team)
            except Refused as error:
                self._refuse(str(error))
                continue
            if (envelope.sender, envelope.instance) != (self.name, self.instance):
                yield Arrival(envelope, received_s)

    def _take(self, data: bytes) -> None:
        """Queue received bytes, in the radio's thread."""
        with self._lock:
            if len(data) > MAX_BYTES:
                self._too_large += 1
                return
            if self._waiting_bytes + len(data) > MAX_WAITING_BYTES:
                self.dropped += 1
                return
            try:
                self._waiting.put_nowait((data, self._clock()))
            except queue.Full:
                self.dropped += 1
            else:
                self._waiting_bytes += len(data)

    def _refuse(self, why: str) -> None:
        """Count a refused message, and report the first one of each reason."""
        if line := self.refusals.refuse(why):
            self._tell(f"refused a message {line}" if " " in line else line)

    def _refuse_large(self) -> None:
        """Count the messages that were too large to be queued."""
        with self._lock:
            count, self._too_large = self._too_large, 0
        for _ in range(count):
            self._refuse(TOO_LARGE)


def matches(pattern: str, topic: str) -> bool:
    """Return whether a topic matches a pattern: `*` is one part, `**` any number of parts."""
    return _matches(pattern.split("/"), topic.split("/"))


def _matches(pattern: list[str], parts: list[str]) -> bool:
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(_matches(pattern[1:], parts[skip:]) for skip in range(len(parts) + 1))
    return bool(parts) and pattern[0] in ("*", parts[0]) and _matches(pattern[1:], parts[1:])


@dataclass
class Air:
    """Simulated medium of the memory radios, with message loss and latency.

    Attributes:
        drop: returns, for a topic and a receiver, whether a message is lost.
        delay_s: returns, for a topic and a receiver, the latency, s.
        now_s: simulated time, which only `advance` changes.
    """

    drop: Callable[[str, str], bool] = lambda topic, receiver: False
    delay_s: Callable[[str, str], float] = lambda topic, receiver: 0.0
    now_s: float = 0.0
    _radios: list["MemoryRadio"] = field(default_factory=list)
    _under_way: list[tuple[float, int, Callable[[bytes], None], bytes]] = field(default_factory=list)
    _count: int = 0

    def radio(self, name: str) -> "MemoryRadio":
        """Return a new radio for the process of this name."""
        self._radios.append(MemoryRadio(self, name))
        return self._radios[-1]

    def advance(self, now_s: float) -> None:
        """Advance the time, and deliver the messages due by then in order."""
        while self._under_way and self._under_way[0][0] <= now_s:
            self.now_s, _, take, data = heappop(self._under_way)
            take(data)
        self.now_s = now_s

    def carry(self, topic: str, data: bytes) -> None:
        """Queue a message for every matching subscriber."""
        for radio in self._radios:
            for pattern, take in radio.listeners:
                if matches(pattern, topic) and not self.drop(topic, radio.name):
                    self._count += 1
                    due_s = self.now_s + self.delay_s(topic, radio.name)
                    heappush(self._under_way, (due_s, self._count, take, data))

    def leave(self, radio: "MemoryRadio") -> None:
        """Remove a closed radio."""
        self._radios.remove(radio)


class MemoryRadio(Radio):
    """A radio whose messages pass through an `Air`.

    Attributes:
        name: of its process, which `Air.drop` and `Air.delay_s` receive.
        listeners: pairs of pattern and callback.
    """

    def __init__(self, air: Air, name: str) -> None:
        self.name = name
        self.listeners: list[tuple[str, Callable[[bytes], None]]] = []
        self._air = air

    def publish(self, topic: str, data: bytes) -> None:
        """Send bytes to all current subscribers."""
        self._air.carry(topic, data)

    def subscribe(self, pattern: str, take: Callable[[bytes], None]) -> None:
        """Call `take` with each message whose topic matches a pattern."""
        self.listeners.append((pattern, take))

    def close(self) -> None:
        """Stop receiving."""
        self._air.leave(self)
