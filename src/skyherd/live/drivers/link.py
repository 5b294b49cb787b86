"""What drivers put on the wire, and the interface of everything that does."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Motion:
    """Velocity of one body in its own frame: x ahead, y to the left, z up. Robots on wheels use two of four.

    Attributes:
        forward_mps: ahead.
        turn_radps: counter-clockwise seen from above.
        left_mps: to the left; flying units only.
        up_mps: upwards; flying units only.
        flies: whether it is a flying unit's, which is sent four speeds, also to stop; a robot on wheels is
            sent two.
    """

    forward_mps: float
    turn_radps: float
    left_mps: float = 0.0
    up_mps: float = 0.0
    flies: bool = False


STILL = Motion(0.0, 0.0)
"""To stand still."""


class Link(Protocol):
    """Where motions are written to: one robot, over one transport. All calls come from one thread.

    Attributes:
        name: what complaints call it; no password in it.
    """

    name: str

    def write(self, motion: Motion) -> None:
        """Send a motion, now or not at all: nothing may be kept to be sent later.

        It may wait for some tenths of a second at most.

        Raises:
            OSError: it could not be sent; the driver says so, and tries the next one.
        """
        ...

    def close(self) -> None:
        """Close what is open, once what was written is out. It is called once, after the last `write`."""
        ...
