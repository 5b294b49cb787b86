"""H.264 encoding and decoding, picture by picture."""

from fractions import Fraction

import av
import numpy as np
from av.codec.context import Flags

from skyherd.geometry import Image

PRESET, TUNE = "veryfast", "zerolatency"
"""Settings of libx264. *Chosen*: fast encoding without lookahead, as in cameras; each picture is output at
once and in order."""

GROUP = 30
"""Pictures from one key frame to the next. *Chosen*: one second of most cameras."""

RATE_HZ = 30
"""Nominal frame rate of the encoder, 1/s. *Chosen*: with a constant rate factor it has little effect."""

FORMAT = "yuvj420p"
"""Pixel format: luma of full range, and chroma at half the resolution, which stays neutral."""

NEUTRAL = 128
"""Value of both chroma planes for grey."""


class VideoStream:
    """H.264 stream of one camera, encoded and decoded on one thread; it is reproducible to the bit.

    Pictures are predicted from earlier ones, so that each camera needs its own stream. Odd sizes are padded
    by repeating the last row or column.

    Attributes:
        bits: size of the stream so far.
        pictures: number of pictures so far.

    Args:
        size_px: width and height of all pictures.
        crf: constant rate factor of x264 from 0, almost lossless, to 51; the quantiser's step doubles every
            6.
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
        """Encode the next picture (height, width), and return it decoded."""
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
    """Return a view of a plane's values (height, width)."""
    rows: Image = np.asarray(memoryview(plane), dtype=np.uint8).reshape(plane.height, plane.line_size)
    return rows[:, : plane.width]
