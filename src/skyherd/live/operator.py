"""What a person at a keyboard may do from any process of the team: arm, stop, and watch."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from skyherd.live.lab import Lab
from skyherd.live.mailbox import Mailbox, Radio
from skyherd.live.wire import Arm, Heartbeat, Stop

REPEAT_S = 0.2
"""Time between two sendings of a command, s. Chosen: messages may be lost."""

SETTLE_S = 3.0
"""How long arm and stop wait for all robots, s. Chosen: a dozen signs of life of each."""

GONE_S = 2.0
"""A process without a sign of life for so long counts as gone, s."""

HEARS = ("heartbeat/**",)
"""What an operator listens to, after the team's name."""


@dataclass
class Watch:
    """The last sign of life of each process.

    Attributes:
        heartbeats: by name, the sign and when it came.
        mailbox: where they come from.
    """

    mailbox: Mailbox
    clock: Callable[[], float]
    heartbeats: dict[str, tuple[Heartbeat, float]] = field(default_factory=dict)

    def listen(self, timeout_s: float) -> None:
        """Take in what has come; wait for something for so long at most."""
        for arrival in self.mailbox.fetch(timeout_s):
            if isinstance(arrival.envelope.message, Heartbeat):
                self.heartbeats[arrival.envelope.sender] = arrival.envelope.message, arrival.received_s

    def alive(self) -> dict[str, Heartbeat]:
        """Signs of life of those that are there, by name."""
        now_s = self.clock()
        return {
            name: heartbeat for name, (heartbeat, at_s) in self.heartbeats.items() if now_s - at_s <= GONE_S
        }


@dataclass(frozen=True)
class Outcome:
    """What came of a command to all robots.

    Attributes:
        done: robots that did it.
        missing: robots that did not say so.
    """

    done: list[int]
    missing: list[int]


def watch(lab: Lab, radio: Radio, clock: Callable[[], float], name: str = "operator") -> Watch:
    """Begin to listen to the team."""
    return Watch(Mailbox(radio, lab.model.team, name, clock, HEARS), clock)


def arm(lab: Lab, watched: Watch, settle_s: float = SETTLE_S) -> Outcome:
    """Let the wheels of all robots turn; returns which of them are armed after `settle_s` at most."""
    return _insist(lab, watched, settle_s, lambda heartbeat: heartbeat.armed, _arm)


def stop(lab: Lab, watched: Watch, why: str, settle_s: float = SETTLE_S) -> Outcome:
    """Stop and disarm all robots; returns which of them are, and the command goes out at once."""
    watched.mailbox.send(Stop(why))
    return _insist(
        lab, watched, settle_s, lambda heartbeat: not heartbeat.armed, lambda w: w.mailbox.send(Stop(why))
    )


def _arm(watched: Watch) -> None:
    sessions = {name: heartbeat.session for name, heartbeat in watched.alive().items() if heartbeat.session}
    if sessions:
        watched.mailbox.send(Arm(sessions))


def _insist(
    lab: Lab,
    watched: Watch,
    settle_s: float,
    is_done: Callable[[Heartbeat], bool],
    ask: Callable[[Watch], object],
) -> Outcome:
    """Ask again and again until all robots have done it, by signs of life that came after the first ask."""
    began_s, asked_s = watched.clock(), float("-inf")
    end_s = time.monotonic() + settle_s
    done: list[int] = []
    while time.monotonic() < end_s and len(done) < len(lab.ids):
        if time.monotonic() - asked_s >= REPEAT_S:
            asked_s = time.monotonic()
            ask(watched)
        watched.listen(0.05)
        done = [
            robot
            for robot in lab.ids
            if (found := watched.heartbeats.get(f"robot/{robot}"))
            and found[1] > began_s
            and is_done(found[0])
        ]
    return Outcome(done, [robot for robot in lab.ids if robot not in done])
