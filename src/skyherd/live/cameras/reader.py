"""Reader thread of a camera, which keeps only the newest picture, or a few."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Self

from skyherd.errors import InputError
from skyherd.live.cameras.frame import Clock, Frame, Picture, Source, StampedBy
from skyherd.live.cameras.sight import Sight
from skyherd.live.cameras.stamps import StreamStamps

_log = logging.getLogger(__name__)

OPEN_S = 10.0
"""Timeout of the first opening, s. *Chosen*: the first key frame of a stream may take some seconds."""

LATE_S = 1.0
"""Watchdog time without a picture, and increase of latency, above which pictures are late, s. *Chosen*: above
the frame interval of any camera."""

OLD_S = 3.0
"""Time with only out-of-order pictures after which a stream is reopened, s. *Chosen*: its clock may have
restarted. Until then the pictures may be repeats, and are dropped."""

FIRST_WAIT_S, MAX_WAIT_S = 0.25, 8.0
"""First and longest pause before a broken stream is reopened, s; each pause doubles. *Chosen*: a short outage
costs little time, and a server that is down gets few requests."""

MIN_STEP_S = 1e-6
"""Shortest interval between two pictures of a reader that keeps several, s. *Chosen*: above zero."""

CLOSE_S = 1.0
"""Longest wait of `close` for the thread, s. *Chosen*: a thread that hangs in a driver ends with the
process."""


class CameraReader:
    """Reader of a source in a separate thread. It returns the newest picture, each at most once.

    With `kept` above 1 it returns the oldest of as many newest pictures instead, so that a short pause of its
    user loses none. It then also gives pictures whose time is still uncertain, in the order of the stream.

    ```python
    with open_camera("rtsp://camera/stream") as camera:
        while not camera.ended:
            frame = camera.newest(timeout_s=0.5)
    ```

    Pictures not taken in time are dropped and counted, so that a slow user sees recent pictures with gaps.
    Recordings with the pace `fast` are the exception: they wait, and drop nothing.

    Args:
        source: source of the pictures.
        clock: returns the time of all stamps, s.
        pause: waits for a number of seconds and returns whether the reader was closed; a real wait if None.
        kept: number of pictures that wait until they are taken.

    Attributes:
        received: number of received pictures.
        dropped: number of received pictures that were not taken in time, or were out of order.
        reconnects: number of times the source was reopened.
        name: name of the source in error messages.
    """

    def __init__(
        self,
        source: Source,
        *,
        clock: Clock = time.monotonic,
        pause: Callable[[float], bool] | None = None,
        kept: int = 1,
    ) -> None:
        self.received = self.dropped = self.reconnects = 0
        self.name = source.name
        self._source, self._clock = source, clock
        self._closing, self._opened = threading.Event(), threading.Event()
        self._pause = self._closing.wait if pause is None else pause
        self._fresh: deque[Frame] = deque(maxlen=kept)
        self._kept, self._stream_s = kept, float("-inf")
        self._arrival = threading.Condition()
        self._over = False
        self._sight = Sight()
        self._broken: str | None = None
        self._since_s = self._last_s = clock()
        self._newest_s = float("-inf")
        self._lag_s = 0.0
        self._old_since_s: float | None = None
        self._refused: InputError | None = None
        self._tries = 0
        self._thread = threading.Thread(target=self._run, name=f"camera {source.name}", daemon=True)

    def start(self, timeout_s: float = OPEN_S) -> Self:
        """Open the source, start reading, and return the reader.

        Raises:
            InputError: the source cannot be opened, or did not open within `timeout_s`. The reader is closed.
        """
        self._thread.start()
        if not self._opened.wait(timeout_s):
            self.close()
            raise InputError(
                self.name, f"did not open within {timeout_s:g} s", "a camera that sends pictures"
            )
        if self._refused is not None:
            self.close()
            raise self._refused
        return self

    def newest(self, timeout_s: float) -> Frame | None:
        """Return the newest picture, each once, or None if none comes within `timeout_s` of real time.

        With `kept` above 1 it is the oldest of those that wait.
        """
        with self._arrival:
            self._arrival.wait_for(lambda: bool(self._fresh) or self._over, timeout_s)
            frame = self._fresh.popleft() if self._fresh else None
            self._arrival.notify_all()
        return frame

    @property
    def waiting(self) -> int:
        """Number of pictures that can be taken at once."""
        return len(self._fresh)

    @property
    def ended(self) -> bool:
        """True if no more pictures will come: a recording has ended, or the reader is closed."""
        with self._arrival:
            return self._over and not self._fresh

    @property
    def trouble(self) -> str | None:
        """Current fault of the pictures (none, late, old, black, frozen) in one line, or None.

        A mirrored camera is detected by its markers: see `MirrorWatch`.
        """
        with self._arrival:
            now_s = self._clock()
            if self._broken is not None:
                tried = f"; tried again {self._tries} time(s)" if self._tries and not self._over else ""
                return f"{self.name}: no picture for {now_s - self._last_s:.1f} s: {self._broken}{tried}"
            why = None if self._over else self._late(now_s) or self._sight.trouble
            return None if why is None else f"{self.name}: {why}"

    def _late(self, now_s: float) -> str | None:
        """Return the timing fault of a camera's pictures as a text, or None."""
        if self._source.pace != "live":
            return None
        if now_s - self._last_s >= LATE_S:
            return f"late: no picture for {now_s - self._last_s:.1f} s; the stream has stalled"
        if self._old_since_s is not None:
            return "old: pictures are no newer than an earlier one; the stream may repeat them"
        if self._lag_s >= LATE_S:
            return (
                f"late: pictures take {self._lag_s:.1f} s longer than they did; the latency of the network "
                "or of this computer is too high"
            )
        return None

    def close(self) -> None:
        """End the thread, and drop the picture that was not taken. Further calls have no effect."""
        self._closing.set()
        with self._arrival:
            self._over = True
            self._fresh.clear()
            self._arrival.notify_all()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(CLOSE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        """Read the source until it ends or the reader is closed. Reopen a broken camera."""
        wait_s = FIRST_WAIT_S
        while not self._closing.is_set():
            received = self.received
            why = self._read()
            if why is None:
                break
            with self._arrival:
                self._broken = why
                self._tries = 0 if self.received > received else self._tries
            if not self._source.lasting:
                break
            if self.received > received:
                wait_s = FIRST_WAIT_S
            _log.info("%s: %s; opened again in %g s", self.name, why, wait_s)
            if self._pause(wait_s):
                break
            wait_s = min(2 * wait_s, MAX_WAIT_S)
            with self._arrival:
                self._tries += 1
        with self._arrival:
            self._over = True
            self._arrival.notify_all()

    def _read(self) -> str | None:
        """Open the source and read it to its end. Return the reason of its failure, or None."""
        stamps = StreamStamps()
        try:
            with self._source.open(self._pause) as pictures:
                with self._arrival:
                    self.reconnects += self._opened.is_set()
                    self._since_s = self._clock()
                    self._old_since_s = None
                    self._stream_s = float("-inf")
                self._opened.set()
                for picture in pictures:
                    if self._closing.is_set():
                        break
                    if not self._take(picture, stamps):
                        return "all its pictures were old"
        except Exception as error:
            refused = (
                error
                if isinstance(error, InputError)
                else InputError(self.name, f"{type(error).__name__}: {error}", "a source of pictures")
            )
            if not self._opened.is_set():
                self._refused = refused
                self._over = True
                self._opened.set()
                self._closing.set()
            return refused.what
        return "it ended" if self._source.lasting else None

    def _take(self, picture: Picture, stamps: StreamStamps) -> bool:
        """Stamp a picture and make it the newest. Return False if the source must be reopened."""
        if self._source.pace == "live":
            return self._take_live(picture, stamps)
        due_s = self._since_s + (picture.stream_s or 0.0)
        if self._source.pace == "own":
            while (left_s := due_s - self._clock()) > 0:
                if self._pause(left_s):
                    return True
        else:
            with self._arrival:
                self._arrival.wait_for(lambda: not self._fresh or self._over)
        self._give(picture, due_s, self._clock(), "stream")
        return True

    def _take_live(self, picture: Picture, stamps: StreamStamps) -> bool:
        """Stamp a picture of a camera. Drop it if it is out of order, or its time is still unknown.

        Return False after `OLD_S` with only out-of-order pictures.
        """
        arrived_s = self._clock()
        captured_s, by, settled = arrived_s, "arrival", True
        if picture.stream_s is not None:
            # The estimated offset may rise, and with it the time of capture of a repeat.
            if picture.stream_s <= self._stream_s:
                return self._drop_old(arrived_s)
            self._stream_s = picture.stream_s
        if picture.age_s is not None:
            captured_s, by = arrived_s - max(picture.age_s, 0.0), "stream"
        elif picture.stream_s is not None:
            captured_s, by = stamps.captured_s(picture.stream_s, arrived_s), "stream"
            settled = stamps.settled
        if self._kept > 1 and picture.stream_s is not None:
            settled = True
            captured_s = max(captured_s, self._newest_s + MIN_STEP_S)
        if not settled:
            with self._arrival:
                self.received += 1
                self.dropped += 1
            return True
        if by == "stream" and captured_s <= self._newest_s:
            return self._drop_old(arrived_s)
        with self._arrival:
            self._old_since_s = None
        self._give(picture, captured_s, arrived_s, "stream" if by == "stream" else "arrival")
        return True

    def _drop_old(self, arrived_s: float) -> bool:
        """Drop a picture no newer than an earlier one. Return False after `OLD_S` with only such pictures."""
        with self._arrival:
            self.received += 1
            self.dropped += 1
            if self._old_since_s is None:
                self._old_since_s = arrived_s
            return arrived_s - self._old_since_s < OLD_S

    def _give(self, picture: Picture, captured_s: float, arrived_s: float, by: StampedBy) -> None:
        """Make a picture the newest."""
        image = picture.image
        image.setflags(write=False)
        frame = Frame(image, captured_s, arrived_s, self.received, by, picture.origin)
        self._sight.look(image, arrived_s)
        with self._arrival:
            self.received += 1
            self.dropped += len(self._fresh) == self._fresh.maxlen
            self._lag_s = arrived_s - captured_s
            self._newest_s, self._last_s = captured_s, arrived_s
            self._broken, self._tries = None, 0
            if not self._over:
                self._fresh.append(frame)
            self._arrival.notify_all()
