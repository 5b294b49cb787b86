"""Conversion of decoded video frames to grey images, upright according to their display matrix."""

from typing import Any

import av
import numpy as np
import numpy.typing as npt
from av.video.reformatter import Interpolation, VideoReformatter

DISPLAY_MATRIX = "DISPLAYMATRIX"
"""Name of a frame's side data with its orientation. *Defined* by FFmpeg."""

ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.split(".")[0]) >= 17 else {}
"""PyAV options that convert pictures in the calling thread. *Measured*: 1200x800 px take 0.05 to 0.3 ms.
PyAV starts a thread per core otherwise from version 17 on; earlier versions lack the option."""

TAG_PX = 16
"""Side of the small copy whose tags are read instead of a frame's, px. *Chosen*: takes 8 µs, and any
conversion accepts the size."""


class UprightGrey:
    """Converter of a stream's decoded frames to grey images, upright as their display matrix says.

    One instance serves a stream, so that conversion buffers are set up once. It retains nothing of a frame:
    memory is released as soon as the frame and its image are unused.

    PyAV's `side_data`, which has the matrix, makes a frame part of a reference cycle that the garbage
    collector frees only hundreds of frames later. The matrix is therefore read from a copy of `TAG_PX`
    pixels, which has the frame's tags without its picture.
    """

    def __init__(self) -> None:
        self._levels, self._tags = VideoReformatter(), VideoReformatter()

    def of(self, picture: av.VideoFrame) -> npt.NDArray[np.uint8]:
        """Return the grey levels (height, width) of a decoded frame, 0 to 255 for any video range."""
        grey = self._levels.reformat(picture, format="gray", **ONE_THREAD)
        tags = self._tags.reformat(
            picture,
            width=TAG_PX,
            height=TAG_PX,
            format="gray",
            interpolation=Interpolation.POINT,
            **ONE_THREAD,
        )
        image = np.asarray(grey.to_ndarray(), dtype=np.uint8)
        return np.ascontiguousarray(_upright(image, tags.side_data))


def _upright(image: npt.NDArray[np.uint8], tags: Any) -> npt.NDArray[np.uint8]:
    """Rotate and mirror an image (height, width) by quarter turns, as its display matrix says.

    The matrix (a, b, ., c, d, ., ...) maps the point (u, v) to (a u + c v, b u + d v), and moves negative
    results back into view. Other angles are rounded to the nearest quarter turn.

    The code iterates over the tags instead of looking up the matrix. PyAV would raise a KeyError where the
    matrix is missing, which is usual, and a signal during that is lost (*measured*: one Ctrl-C of a hundred
    early in a video).
    """
    matrix: Any = next((data for data in tags if data.type.name == DISPLAY_MATRIX), None)
    if matrix is None:
        return image
    a, b, _, c, d = np.frombuffer(bytes(matrix), dtype=np.int32)[:5].tolist()
    if abs(b) + abs(c) > abs(a) + abs(d):
        image, a, d = image.T, c, b
    return image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]
