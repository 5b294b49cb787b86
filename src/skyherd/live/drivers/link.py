"""Motions of robots, and the interface of links that transmit them."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class Motion:
    """Velocity of one body in its own frame: x forward, y left, z up. Wheeled robots use two of four values.

    Attributes:
        forward_mps: forward speed.
        turn_radps: turn rate, counter-clockwise seen from above.
        left_mps: speed to the left; flying units only.
        up_mps: climb rate; flying units only.
        flies: True for a flying unit, which receives four speeds, also to stop; a wheeled robot receives two.
    """

    forward_mps: float
    turn_radps: float
    left_mps: float = 0.0
    up_mps: float = 0.0
    flies: bool = False


STILL = Motion(0.0, 0.0)
"""Motion of a robot that stands still."""


class Link(Protocol):
    """Connection to one robot over one transport. All calls come from one thread.

    Attributes:
        name: name in error messages, without a password.
    """

    name: str

    def write(self, motion: Motion) -> None:
        """Send a motion at once or discard it: a delayed command would be stale.

        It may block for at most a few tenths of a second.

        Raises:
            OSError: the motion could not be sent. The driver reports it and continues with the next motion.
        """
        ...

    def close(self) -> None:
        """Send pending data and close the connection. Called once, after the last `write`."""
        ...
