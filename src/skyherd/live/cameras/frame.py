"""What a camera gives: a picture with the times at which it was taken and came in."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

Grey = npt.NDArray[np.uint8]
"""Grey levels of 8 bits, (height, width)."""

Clock = Callable[[], float]
"""Gives the time, s, from any beginning; it never goes backwards."""

StampedBy = Literal["stream", "arrival"]
"""What the time of capture comes from: the stream's own clock, or the moment at which the picture came in."""


@dataclass(frozen=True)
class Frame:
    """A picture of a camera, and its times on the clock that the reader was given.

    Attributes:
        image: grey levels (height, width); read-only.
        captured_s: when it was taken, as well as is known; see `stamped_by`.
        arrived_s: when it came in, decoded.
        number: how many pictures had come in before it. What is missing between two frames was dropped.
        stamped_by: `stream` if `captured_s` follows the clock of the stream, so that delays on the way that
            change are in `arrived_s` alone; `arrival` if there is no such clock and the two are the same.
    """

    image: Grey
    captured_s: float
    arrived_s: float
    number: int
    stamped_by: StampedBy


@dataclass(frozen=True)
class Picture:
    """A picture as a source has it.

    Attributes:
        image: grey levels (height, width).
        stream_s: its time on the stream's own clock, whose beginning nobody knows; None if there is none.
        age_s: how long ago it was taken, where the source knows that for certain; None otherwise.
    """

    image: Grey
    stream_s: float | None = None
    age_s: float | None = None


class Source(Protocol):
    """Where pictures come from: opened, read to its end or until it breaks, and perhaps opened again.

    Attributes:
        name: what complaints call it; no password in it.
    """

    name: str

    @property
    def lasting(self) -> bool:
        """Whether it is a camera, of which more is to be expected after it broke off; a recording ends."""
        ...

    @property
    def pace(self) -> Literal["live", "own", "fast"]:
        """How a recording is played, `live` for what is none.

        `own` waits until each picture is due by its `stream_s`, `fast` until the one before was taken by the
        reader's user.
        """
        ...

    def open(self, pause: Callable[[float], bool]) -> AbstractContextManager[Iterator[Picture]]:
        """Open it: the pictures, one after the other, for the body of a `with`.

        Called in a thread of the reader. It may wait for a picture as long as it has to, but only by `pause`
        or with a time-out of some seconds.

        Args:
            pause: waits for so many seconds, or less if the reader is closed; returns whether it is.

        Raises:
            InputError: it cannot be opened or, from the iterator, breaks off; one clear line.
        """
        ...
