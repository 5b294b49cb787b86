"""A rendered camera as a network camera: H.264 in FLV over TCP, for one viewer at a time."""

import socket
import threading
from contextlib import suppress
from fractions import Fraction

import av
import numpy as np

from skyherd.errors import InputError
from skyherd.geometry import Image

QUALITY = {"preset": "ultrafast", "tune": "zerolatency", "crf": "18"}
"""Encoder options of x264. Chosen: no buffering, as in a network camera."""

KEY_FRAME_S = 2.0
"""Key frame interval, s. Chosen."""

FULL_RANGE = 2
"""FFmpeg's code of the full range of grey levels (0 to 255 instead of 16 to 235)."""

MILLISECOND = Fraction(1, 1000)
"""Time unit of FLV, s."""


class CameraStream:
    """Server of one camera's newest picture, encoded in a separate thread.

    Attributes:
        port: TCP port on loopback.
        sent: number of pictures sent.

    Args:
        size_px: width and height of the pictures.
        rate_hz: frame rate in real time.
        port: as the attribute; 0 for any free port.

    Raises:
        InputError: the port is taken.
    """

    def __init__(self, size_px: tuple[int, int], rate_hz: float, port: int) -> None:
        self.sent = 0
        self._size_px, self._rate_hz = size_px, rate_hz
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind(("127.0.0.1", port))
        except OSError as error:
            raise InputError("port", f"{port}: {error.strerror or error}", "a free port") from None
        self.port = int(self._socket.getsockname()[1])
        self._socket.listen(1)
        self._socket.settimeout(0.2)
        self._newest: tuple[Image, float] | None = None
        self._news = threading.Condition()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"camera {self.port}", daemon=True)
        self._thread.start()

    def show(self, image: Image, taken_s: float) -> None:
        """Replace the newest picture. `taken_s` is its time of capture on any clock."""
        with self._news:
            self._newest = image, taken_s
            self._news.notify()

    def close(self) -> None:
        """End the stream."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(2.0)
        self._socket.close()

    def _run(self) -> None:
        while not self._closing:
            try:
                viewer, _ = self._socket.accept()
            except TimeoutError:
                continue
            except OSError:
                return
            viewer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            viewer.settimeout(5.0)
            with viewer, suppress(OSError, av.FFmpegError):
                self._serve(viewer)

    def _serve(self, viewer: socket.socket) -> None:
        """Send pictures to one viewer until it disconnects."""
        container = av.open(_Pipe(viewer), "w", format="flv")
        stream = container.add_stream("libx264", rate=max(1, round(self._rate_hz)), options=QUALITY)
        stream.width, stream.height = (side + side % 2 for side in self._size_px)
        stream.pix_fmt = "yuv420p"
        context = stream.codec_context
        context.thread_count = 1
        context.color_range = FULL_RANGE
        context.gop_size = max(1, round(KEY_FRAME_S * self._rate_hz))
        last = -1
        try:
            while True:
                with self._news:
                    self._news.wait_for(lambda: self._newest is not None or self._closing)
                    if self._closing:
                        return
                    (image, taken_s), self._newest = self._newest, None  # type: ignore[misc]
                picture = av.VideoFrame.from_ndarray(_yuv(image), format="yuv420p")
                last = max(last + 1, round(taken_s * 1000))
                picture.pts, picture.time_base = last, MILLISECOND
                picture.color_range = FULL_RANGE
                container.mux(stream.encode(picture))
                self.sent += 1
        finally:
            with suppress(OSError, av.FFmpegError):
                container.close()


class _Pipe:
    """File-like adapter of a socket for PyAV."""

    def __init__(self, viewer: socket.socket) -> None:
        self._viewer = viewer

    def write(self, data: bytes) -> int:
        """Send all data, and return its length."""
        self._viewer.sendall(data)
        return len(data)


def _yuv(image: Image) -> Image:
    """Return the YUV planes of a grey image (height, width), with neutral colour.

    H.264 requires even sides: the last row or column of an odd side is repeated.
    """
    image = np.pad(image, [(0, side % 2) for side in image.shape], mode="edge")
    height, width = image.shape
    plane = np.full((height // 2, width), 128, dtype=np.uint8)
    return np.concatenate([image, plane])
