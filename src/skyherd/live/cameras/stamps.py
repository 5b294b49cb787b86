"""Time of capture of a picture, estimated from the stream's clock."""

DRIFT = 2e-4
"""Largest drift of a stream's clock behind ours, s/s. *Chosen*: twice the error of cheap camera crystals
(100 ppm)."""

BURST = 0.5
"""Ratio of arrival interval to stream interval below which a picture was buffered. *Chosen*: unbuffered
pictures have a ratio of about 1."""

MAX_BURST_S = 2.0
"""Longest burst of buffered pictures at the beginning, s. *Chosen*: servers buffer about one second."""


class StreamStamps:
    """Estimator of the time of capture from a stream's time stamps.

    The two clocks differ by an unknown offset. The picture with the smallest latency bounds it:

        offset = min over pictures of (arrived - stream),   captured = stream + offset,

    where the minimum may rise by `DRIFT` of the elapsed time. The estimate removes variable latency. It does
    not see the latency common to all pictures (exposure, encoding, transport). The time of capture is never
    later than the arrival.

    Each connection needs a new estimator: streams restart their clocks.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._began_s = self._stream_s = self._arrived_s = 0.0
        self.settled = False
        """True after the first picture that was not buffered. Servers send buffered pictures to a new client,
        and the estimated times of these are too late."""

    def captured_s(self, stream_s: float, arrived_s: float) -> float:
        """Return the estimated time of capture of a picture, s, on our clock.

        Args:
            stream_s: its time on the stream's clock.
            arrived_s: its time of arrival on our clock.
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
