"""Turns the decoded frames of videos into grey images, upright as its tag says that the camera was held."""

from typing import Any

import av
import numpy as np
import numpy.typing as npt
from av.video.reformatter import Interpolation, VideoReformatter

DISPLAY_MATRIX = "DISPLAYMATRIX"
"""Name of the data beside a frame that say how it is to be turned. *Defined* by FFmpeg."""

ONE_THREAD: dict[str, Any] = {"threads": 1} if int(av.__version__.split(".")[0]) >= 17 else {}
"""What PyAV is told so that it converts pictures in the thread that asks. *Measured*: 1200 x 800 px take 0.05
to 0.3 ms; from version 17 on it starts a thread for each core otherwise, and before it knows no such word."""

TAG_PX = 16
"""Sides of the picture whose tags are read in place of a frame's. *Chosen*: takes 8 microseconds, and
is of a size that any conversion takes."""


class UprightGrey:
    """Turns the decoded frames of a stream into grey images, upright as their display matrix says.

    One is kept for a stream, so that what a conversion needs is set up once. Nothing of a frame stays behind:
    what it holds is given back as soon as it and its image are no longer used. PyAV's `side_data`, which has
    the matrix, makes a frame hold itself until Python looks for such circles, hundreds of frames later; so it
    is asked of a copy of `TAG_PX` pixels, which has a frame's tags without its picture.
    """

    def __init__(self) -> None:
        self._levels, self._tags = VideoReformatter(), VideoReformatter()

    def of(self, picture: av.VideoFrame) -> npt.NDArray[np.uint8]:
        """Grey levels (height, width) of a decoded frame, from 0 to 255 whatever the range of the video's."""
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
    """The image (height, width) as the display matrix among its tags turns and mirrors it, by quarter turns.

    The matrix (a, b, ., c, d, ., ...) takes the point (u, v) to (a u + c v, b u + d v), and what is then
    negative back into view. Of angles in between, the nearest quarter turn is taken.

    The tags are gone through and not asked for the matrix by its name: where it is missing, as it mostly is,
    PyAV would raise a KeyError, and a signal that comes while it does is lost (*measured*: one Ctrl-C of a
    hundred early in a video).
    """
    matrix: Any = next((data for data in tags if data.type.name == DISPLAY_MATRIX), None)
    if matrix is None:
        return image
    a, b, _, c, d = np.frombuffer(bytes(matrix), dtype=np.int32)[:5].tolist()
    if abs(b) + abs(c) > abs(a) + abs(d):
        image, a, d = image.T, c, b
    return image[:: -1 if d < 0 else 1, :: -1 if a < 0 else 1]
