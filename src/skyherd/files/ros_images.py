"""Images of ROS messages, `sensor_msgs/Image` and `sensor_msgs/CompressedImage`, as grey images."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.files.images import MAX_PIXELS, Grey, grey_of_bytes, grey_of_levels

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
"""Types of the messages that are images."""

Levels = npt.NDArray[Any]
"""Levels (height, width) or (height, width, channels) of a message."""


def _converted(code: int) -> Callable[[Levels], Levels]:
    return lambda levels: cv2.cvtColor(levels, code)


def _itself(levels: Levels) -> Levels:
    return levels


ENCODINGS: dict[str, tuple[str, int, Callable[[Levels], Levels]]] = {
    "mono8": ("u1", 1, _itself),
    "8UC1": ("u1", 1, _itself),
    "mono16": ("u2", 1, _itself),
    "16UC1": ("u2", 1, _itself),
    "rgb8": ("u1", 3, _converted(cv2.COLOR_RGB2GRAY)),
    "bgr8": ("u1", 3, _converted(cv2.COLOR_BGR2GRAY)),
    "8UC3": ("u1", 3, _converted(cv2.COLOR_BGR2GRAY)),
    "rgba8": ("u1", 4, _converted(cv2.COLOR_RGBA2GRAY)),
    "bgra8": ("u1", 4, _converted(cv2.COLOR_BGRA2GRAY)),
    "rgb16": ("u2", 3, _converted(cv2.COLOR_RGB2GRAY)),
    "bgr16": ("u2", 3, _converted(cv2.COLOR_BGR2GRAY)),
    "bayer_rggb8": ("u1", 1, _converted(cv2.COLOR_BayerRGGB2GRAY)),
    "bayer_bggr8": ("u1", 1, _converted(cv2.COLOR_BayerBGGR2GRAY)),
    "bayer_gbrg8": ("u1", 1, _converted(cv2.COLOR_BayerGBRG2GRAY)),
    "bayer_grbg8": ("u1", 1, _converted(cv2.COLOR_BayerGRBG2GRAY)),
    "yuv422": ("u1", 2, lambda levels: levels[..., 1]),
    "uyvy": ("u1", 2, lambda levels: levels[..., 1]),
    "yuv422_yuy2": ("u1", 2, lambda levels: levels[..., 0]),
    "yuyv": ("u1", 2, lambda levels: levels[..., 0]),
}
"""Number type, channels and conversion to grey of each encoding that is read. Defined by sensor_msgs."""


class DamagedImageError(Exception):
    """An image that cannot be decoded; the next ones may be.

    Attributes:
        problem: the same as an error of the user.
    """

    def __init__(self, problem: InputError) -> None:
        super().__init__(str(problem))
        self.problem = problem


def grey_of_message(where: str, message: Any, kind: str) -> Grey:
    """Return the grey image (height, width) of a message.

    Args:
        where: name of the image in errors.
        message: the message, as `rosbags` reads it.
        kind: its type, `RAW` or `COMPRESSED`.

    Raises:
        DamagedImageError: the image cannot be decoded; the next ones may be.
        InputError: its encoding is not read.
    """
    if kind == COMPRESSED:
        if "compressedDepth" in message.format:
            raise InputError(where, f"format {message.format!r} is not read", "JPEG, PNG or another picture")
        try:
            return grey_of_bytes(message.data.tobytes(), where)
        except InputError as error:
            raise DamagedImageError(error) from None
    encoding = message.encoding
    if encoding not in ENCODINGS:
        raise InputError(where, f"encoding {encoding!r} is not read", f"one of {', '.join(ENCODINGS)}")
    number, channels, to_grey = ENCODINGS[encoding]
    size = np.dtype(number).itemsize * channels
    height, width, step = message.height, message.width, message.step
    short = step < width * size or message.data.size < step * height
    if short or not 0 < height * width <= MAX_PIXELS:
        what = f"damaged: {width}x{height} px, rows of {step} bytes, {message.data.size} bytes"
        raise DamagedImageError(InputError(where, what, "an image that is whole"))
    rows = message.data[: step * height].reshape(height, step)[:, : width * size]
    order = ">" if message.is_bigendian else "<"
    levels = np.ascontiguousarray(rows).view(order + number).astype(number)
    grey = to_grey(levels.reshape((height, width, channels) if channels > 1 else (height, width)))
    return np.ascontiguousarray(grey) if number == "u1" else grey_of_levels(grey)
