"""Messages in Foxglove's schemas, which MCAP viewers draw without configuration.

Images are `foxglove.CompressedImage`, overlays `foxglove.ImageAnnotations`, and ground positions
`foxglove.FrameTransforms`, all as JSON. Foxglove's pixel origin is the corner of the first pixel, ours its
centre.
"""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.drawing.palette import rgb
from skyherd.geometry import Array
from skyherd.recording.mcap_log import Schema, nanoseconds

CORNER_PX = 0.5
"""Offset of Foxglove's pixel coordinates from ours. Derived: a pixel's corner is half a pixel from its
centre."""

LINE_LOOP, LINE_LIST = 2, 4
"""Types of `foxglove.PointsAnnotation`: a closed line, and single segments."""

CLEAR = {"r": 0.0, "g": 0.0, "b": 0.0, "a": 0.0}
"""Transparent colour."""

_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}


def _object(title: str, **properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "title": title, "properties": properties, "required": list(properties)}


def _list_of(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_TIME = _object("time", sec={"type": "integer"}, nsec={"type": "integer"})
_COLOR = _object("foxglove.Color", r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_POINT = _object("foxglove.Point2", x=_NUMBER, y=_NUMBER)
_METADATA = _list_of(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT))

IMAGE: Schema = (
    "foxglove.CompressedImage",
    _object(
        "foxglove.CompressedImage",
        timestamp=_TIME,
        frame_id=_TEXT,
        data={"type": "string", "contentEncoding": "base64"},
        format=_TEXT,
    ),
)
"""Schema of images."""

ANNOTATIONS: Schema = (
    "foxglove.ImageAnnotations",
    _object(
        "foxglove.ImageAnnotations",
        timestamp=_TIME,
        circles=_list_of(
            _object(
                "foxglove.CircleAnnotation",
                timestamp=_TIME,
                position=_POINT,
                diameter=_NUMBER,
                thickness=_NUMBER,
                fill_color=_COLOR,
                outline_color=_COLOR,
                metadata=_METADATA,
            )
        ),
        points=_list_of(
            _object(
                "foxglove.PointsAnnotation",
                timestamp=_TIME,
                type={"type": "integer"},
                points=_list_of(_POINT),
                outline_color=_COLOR,
                outline_colors=_list_of(_COLOR),
                fill_color=_COLOR,
                thickness=_NUMBER,
                metadata=_METADATA,
            )
        ),
        texts=_list_of(
            _object(
                "foxglove.TextAnnotation",
                timestamp=_TIME,
                position=_POINT,
                text=_TEXT,
                font_size=_NUMBER,
                text_color=_COLOR,
                background_color=_COLOR,
                metadata=_METADATA,
            )
        ),
        metadata=_METADATA,
    ),
)
"""Schema of image overlays."""

TRANSFORMS: Schema = (
    "foxglove.FrameTransforms",
    _object(
        "foxglove.FrameTransforms",
        transforms=_list_of(
            _object(
                "foxglove.FrameTransform",
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER),
                rotation=_object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER),
            )
        ),
    ),
)
"""Schema of ground positions."""


def time_of(time_s: float) -> dict[str, int]:
    """Return a time in Foxglove's format."""
    at_ns = nanoseconds(time_s)
    return {"sec": at_ns // 10**9, "nsec": at_ns % 10**9}


def compressed_image(
    image: npt.NDArray[np.uint8], time_s: float, frame_id: str, quality: int
) -> dict[str, Any]:
    """Encode an image (height, width) as JPEG of a quality in per cent, in the schema `IMAGE`."""
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return {
        "timestamp": time_of(time_s),
        "frame_id": frame_id,
        "data": base64.b64encode(data.tobytes()).decode(),
        "format": "jpeg",
    }


class Overlay:
    """Overlay of one image, collected into a message of the schema `ANNOTATIONS`.

    Args:
        time_s: time of the image.
        scale: recorded pixels per pixel of the image in which points are given.
    """

    def __init__(self, time_s: float, scale: float = 1.0) -> None:
        self._time, self._scale = time_of(time_s), scale
        self._drawn: dict[str, list[dict[str, Any]]] = {"circles": [], "points": [], "texts": []}

    @property
    def message(self) -> dict[str, Any]:
        """Return the overlay as a message."""
        return {"timestamp": self._time, **self._drawn, "metadata": []}

    def lines(self, kind: int, points_px: Array, color: str, thickness: float = 2.0) -> None:
        """Draw lines between points (N, 2): `LINE_LOOP` or `LINE_LIST`."""
        drawn = {
            "type": kind,
            "points": [self._place(point) for point in points_px],
            "outline_color": _color(color),
            "outline_colors": [],
            "fill_color": CLEAR,
            "thickness": thickness,
        }
        self._add("points", drawn)

    def circle(self, center_px: Array, diameter: float, color: str, thickness: float = 2.0) -> None:
        """Draw a circle of a diameter in pixels of the recorded image around a point (2,)."""
        drawn = {
            "position": self._place(center_px),
            "diameter": diameter,
            "thickness": thickness,
            "fill_color": CLEAR,
            "outline_color": _color(color),
        }
        self._add("circles", drawn)

    def text(self, place_px: Array, text: str, color: str, ground: str, size: float = 12.0) -> None:
        """Draw a text of a size in pixels on a coloured background; its lower left corner is at a point."""
        drawn = {
            "position": self._place(place_px),
            "text": text,
            "font_size": size,
            "text_color": _color(color),
            "background_color": _color(ground),
        }
        self._add("texts", drawn)

    def _add(self, kind: str, drawn: dict[str, Any]) -> None:
        self._drawn[kind].append({"timestamp": self._time} | drawn | {"metadata": []})

    def _place(self, point_px: Sequence[float] | Array) -> dict[str, float]:
        u_px, v_px = point_px
        return {"x": self._scale * (float(u_px) + CORNER_PX), "y": self._scale * (float(v_px) + CORNER_PX)}


def _color(color: str) -> dict[str, float]:
    red, green, blue = rgb(color)
    return {"r": red / 255, "g": green / 255, "b": blue / 255, "a": 1.0}


def frame_transforms(
    time_s: float, parent: str, places: Mapping[str, tuple[float, float, float]]
) -> dict[str, Any]:
    """Return ground poses by name, x, y and angle about z in rad, in the schema `TRANSFORMS`."""
    return {
        "transforms": [
            {
                "timestamp": time_of(time_s),
                "parent_frame_id": parent,
                "child_frame_id": name,
                "translation": {"x": x, "y": y, "z": 0.0},
                "rotation": {"x": 0.0, "y": 0.0, "z": np.sin(angle_rad / 2), "w": np.cos(angle_rad / 2)},
            }
            for name, (x, y, angle_rad) in places.items()
        ]
    }
