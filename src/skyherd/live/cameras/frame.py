"""Pictures of a camera with their times of capture and arrival, and the interface of sources."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal, Protocol

from skyherd.files.images import Grey

Clock = Callable[[], float]
"""Function that returns a monotonic time, s, with an arbitrary origin."""

StampedBy = Literal["stream", "arrival"]
"""Source of the time of capture: the stream's own clock, or the arrival of the picture."""


@dataclass(frozen=True)
class Origin:
    """Header of an image message of ROS.

    Attributes:
        stamp_ns: its time since 1970, ns, by the sender's clock; 0 without one.
        frame: name of the camera's coordinate frame.
    """

    stamp_ns: int
    frame: str


@dataclass(frozen=True)
class Frame:
    """A picture of a camera, with its times on the reader's clock.

    Attributes:
        image: grey levels (height, width); read-only.
        captured_s: estimated time of capture; see `stamped_by`.
        arrived_s: time at which the decoded picture was received.
        number: number of pictures received before it. Gaps between two frames are dropped pictures.
        stamped_by: `stream` if `captured_s` follows the clock of the stream and excludes variable latency;
            `arrival` if there is no such clock, and `captured_s` equals `arrived_s`.
        origin: header of its message; None for a source other than ROS.
    """

    image: Grey
    captured_s: float
    arrived_s: float
    number: int
    stamped_by: StampedBy
    origin: Origin | None = None


@dataclass(frozen=True)
class Picture:
    """A picture as a source delivers it.

    Attributes:
        image: grey levels (height, width).
        stream_s: its time on the stream's own clock, with an unknown origin; None without such a clock.
        age_s: time since capture, if the source knows it exactly; else None.
        origin: header of its message, from ROS.
    """

    image: Grey
    stream_s: float | None = None
    age_s: float | None = None
    origin: Origin | None = None


class Source(Protocol):
    """Source of pictures, which the reader opens, reads until it ends or fails, and may reopen.

    Attributes:
        name: name in error messages, without a password.
    """

    name: str

    @property
    def lasting(self) -> bool:
        """True for a camera, which is reopened after a failure; False for a recording, which ends."""
        ...

    @property
    def pace(self) -> Literal["live", "own", "fast"]:
        """Playback of a recording, or `live` for a camera.

        `own` waits until each picture is due by its `stream_s`. `fast` waits until the reader's user has
        taken the previous picture.
        """
        ...

    def open(self, pause: Callable[[float], bool]) -> AbstractContextManager[Iterator[Picture]]:
        """Return a context manager that opens the source and yields the iterator of its pictures.

        The reader calls it in its thread. It may wait for a picture indefinitely, but only by `pause` or with
        a timeout of a few seconds.

        Args:
            pause: waits for a number of seconds, or until the reader is closed. Returns whether it is closed.

        Raises:
            InputError: the source cannot be opened or, from the iterator, fails.
        """
        ...
