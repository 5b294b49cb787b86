"""When a picture was taken, told from the stream's clock."""

DRIFT = 2e-4
"""Most that a stream's clock may be slower than ours, s a second. *Chosen*: crystals of cheap cameras are off
by a hundred millionths at most; twice that is allowed for."""

BURST = 0.5
"""A picture that comes sooner after another than this share of their distance on the stream's clock had been
waiting somewhere. *Chosen*: pictures that come at their pace have a share of 1."""

MAX_BURST_S = 2.0
"""A burst at the beginning is over after so long, s. *Chosen*: servers keep a second or so."""


class StreamStamps:
    """Times of capture from the times that a stream has for its pictures.

    The two clocks differ by an offset that nobody tells. The picture that came in soonest after its time on
    the stream's clock was delayed least, so that

        offset = min over pictures of (arrived - stream),   captured = stream + offset,

    where the minimum may rise by `DRIFT` of the time that passed. Of a delay, what is common to all pictures
    is not seen (exposure, encoding, the way), and what comes on top for some of them is taken off. Times
    never lie after the arrival.

    One that is opened for a new connection begins anew: streams restart their clocks.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._began_s = self._stream_s = self._arrived_s = 0.0
        self.settled = False
        """Whether a first picture came at its own pace: those before it had been waiting somewhere for an
        unknown time, as servers keep some for whoever connects, and their times are too late."""

    def captured_s(self, stream_s: float, arrived_s: float) -> float:
        """When the picture was taken, on our clock.

        Args:
            stream_s: its time on the stream's clock.
            arrived_s: when it came in, on ours.
        """
        offset_s = arrived_s - stream_s
        if self._offset_s is None:
            self._offset_s, self._began_s = offset_s, arrived_s
        else:
            passed_s = max(arrived_s - self._arrived_s, 0.0)
            self._offset_s = min(self._offset_s + DRIFT * passed_s, offset_s)
            at_pace = passed_s >= BURST * (stream_s - self._stream_s)
            self.settled |= at_pace or arrived_s - self._began_s >= MAX_BURST_S
        self._stream_s, self._arrived_s = stream_s, arrived_s
        return stream_s + self._offset_s
