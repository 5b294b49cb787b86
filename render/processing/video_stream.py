"""A video stream in H.264 and back, picture by picture."""

from fractions import Fraction

import av
import numpy as np
from av.codec.context import Flags

from skyherd.geometry import Image

PRESET, TUNE = "veryfast", "zerolatency"
"""Settings of libx264. *Chosen*: cameras encode fast and send each picture at once, without looking ahead, so
that pictures come out in the order and as many as they went in."""

GROUP = 30
"""Pictures from one that stands for itself to the next. *Chosen*: a second of most cameras."""

RATE_HZ = 30
"""Pictures a second that the encoder is told. *Chosen*: constant quality depends little on it."""

FORMAT = "yuvj420p"
"""Luma of all 256 levels, and colour at half the resolution, which stays grey."""

NEUTRAL = 128
"""Value of both colour planes where there is no colour."""


class VideoStream:
    """One camera's H.264 stream, encoded and decoded picture by picture, on one thread, to the same bits.

    Pictures are predicted from those before them, so that a stream remembers: each camera has its own. Odd
    sizes are made even by repeating the last row or column.

    Attributes:
        bits: size of the stream so far.
        pictures: how many went through it.

    Args:
        size_px: width and height of all pictures.
        crf: constant rate factor of x264 from 0, almost lossless, to 51; the quantiser's step doubles with
            every 6.
    """

    def __init__(self, size_px: tuple[int, int], crf: int) -> None:
        self.bits, self.pictures = 0, 0
        self._size_px = size_px
        encoder = av.CodecContext.create("libx264", "w")
        encoder.width, encoder.height = (length + length % 2 for length in size_px)
        encoder.pix_fmt, encoder.gop_size, encoder.thread_count = FORMAT, GROUP, 1
        encoder.time_base, encoder.framerate = Fraction(1, RATE_HZ), Fraction(RATE_HZ)
        encoder.options = {"crf": str(crf), "preset": PRESET, "tune": TUNE}
        decoder = av.CodecContext.create("h264", "r")
        decoder.thread_count = 1
        decoder.flags |= Flags.low_delay
        self._encoder, self._decoder = encoder, decoder

    def send(self, image: Image) -> Image:
        """Return the next picture (height, width), as it comes out at the other end."""
        width, height = self._size_px
        picture = av.VideoFrame(self._encoder.width, self._encoder.height, FORMAT)
        for plane in picture.planes:
            _pixels(plane)[:] = NEUTRAL
        _pixels(picture.planes[0])[:] = np.pad(image, ((0, height % 2), (0, width % 2)), mode="edge")
        picture.pts = self.pictures
        packets = self._encoder.encode(picture)
        self.bits += 8 * sum(packet.size for packet in packets)
        self.pictures += 1
        (seen,) = (frame for packet in packets for frame in self._decoder.decode(packet))
        return _pixels(seen.planes[0])[:height, :width].copy()


def _pixels(plane: av.video.plane.VideoPlane) -> Image:
    """Return the plane's values (height, width), which can be written to if it can."""
    rows: Image = np.asarray(memoryview(plane), dtype=np.uint8).reshape(plane.height, plane.line_size)
    return rows[:, : plane.width]
