"""Messages in Foxglove's schemas, which MCAP viewers draw without configuration.

Images are `foxglove.CompressedImage`, overlays `foxglove.ImageAnnotations`, poses `foxglove.FrameTransforms`,
and bodies `foxglove.SceneUpdate`, all as JSON. Foxglove's pixel origin is the corner of the first pixel, ours
its centre.
"""

import base64
import math
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

_VECTOR = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_ROTATION = _object("foxglove.Quaternion", x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object("foxglove.Pose", position=_VECTOR, orientation=_ROTATION)
_POINT3 = _object("foxglove.Point3", x=_NUMBER, y=_NUMBER, z=_NUMBER)

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
                translation=_VECTOR,
                rotation=_ROTATION,
            )
        ),
    ),
)
"""Schema of poses."""

_DURATION = _object("duration", sec={"type": "integer"}, nsec={"type": "integer"})
_CUBE = _object("foxglove.CubePrimitive", pose=_POSE, size=_VECTOR, color=_COLOR)
_CYLINDER = _object(
    "foxglove.CylinderPrimitive",
    pose=_POSE,
    size=_VECTOR,
    bottom_scale=_NUMBER,
    top_scale=_NUMBER,
    color=_COLOR,
)
_LINE = _object(
    "foxglove.LinePrimitive",
    type={"type": "integer"},
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant={"type": "boolean"},
    points=_list_of(_POINT3),
    color=_COLOR,
    colors=_list_of(_COLOR),
    indices=_list_of({"type": "integer"}),
)
_TEXT3 = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard={"type": "boolean"},
    font_size=_NUMBER,
    scale_invariant={"type": "boolean"},
    color=_COLOR,
    text=_TEXT,
)

SCENE: Schema = (
    "foxglove.SceneUpdate",
    _object(
        "foxglove.SceneUpdate",
        deletions=_list_of(_object("foxglove.SceneEntityDeletion", timestamp=_TIME, id=_TEXT)),
        entities=_list_of(
            _object(
                "foxglove.SceneEntity",
                timestamp=_TIME,
                frame_id=_TEXT,
                id=_TEXT,
                lifetime=_DURATION,
                frame_locked={"type": "boolean"},
                metadata=_METADATA,
                arrows=_list_of({"type": "object"}),
                cubes=_list_of(_CUBE),
                spheres=_list_of({"type": "object"}),
                cylinders=_list_of(_CYLINDER),
                lines=_list_of(_LINE),
                triangles=_list_of({"type": "object"}),
                texts=_list_of(_TEXT3),
                models=_list_of({"type": "object"}),
            )
        ),
    ),
)
"""Schema of bodies and lines in space."""

_PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")

LINE_STRIP = 0
"""Type of `foxglove.LinePrimitive`: a line through all points."""

LINE_PX = 3.0
"""Thickness of lines in the scene, px."""

ORIGIN = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}
"""Pose of an entity's frame."""


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
    time_s: float, parent: str, places: Mapping[str, tuple[float, float, float, float]]
) -> dict[str, Any]:
    """Return poses by name, x, y and z in m and angle about z in rad, in the schema `TRANSFORMS`."""
    return {
        "transforms": [
            frame_transform(
                time_s, parent, name, place_m, (0.0, 0.0, math.sin(angle_rad / 2), math.cos(angle_rad / 2))
            )
            for name, (*place_m, angle_rad) in places.items()
        ]
    }


def frame_transform(
    time_s: float, parent: str, child: str, position_m: Sequence[float], quaternion: Sequence[float]
) -> dict[str, Any]:
    """Return the pose of a child frame in its parent: position (3,) and quaternion (x, y, z, w)."""
    return {
        "timestamp": time_of(time_s),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": dict(zip("xyz", position_m, strict=True)),
        "rotation": dict(zip("xyzw", quaternion, strict=True)),
    }


def scene_update(entities: list[dict[str, Any]]) -> dict[str, Any]:
    """Return entities in the schema `SCENE`; they replace those of the same id and topic."""
    return {"deletions": [], "entities": entities}


def entity(time_s: float, name: str, frame_id: str, **primitives: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return primitives, by kind, that move with a frame until they are replaced."""
    return {
        "timestamp": time_of(time_s),
        "frame_id": frame_id,
        "id": name,
        "lifetime": time_of(0.0),
        "frame_locked": True,
        "metadata": [],
        **{kind: list(primitives.get(kind, [])) for kind in _PRIMITIVES},
    }


def cube(size_m: tuple[float, float, float], color: str) -> dict[str, Any]:
    """Return a box about the origin of its frame."""
    x, y, z = size_m
    return {"pose": ORIGIN, "size": {"x": x, "y": y, "z": z}, "color": _color(color)}


def cylinder(diameter_m: float, height_m: float, color: str) -> dict[str, Any]:
    """Return an upright cylinder about the origin of its frame."""
    size = {"x": diameter_m, "y": diameter_m, "z": height_m}
    return {"pose": ORIGIN, "size": size, "bottom_scale": 1.0, "top_scale": 1.0, "color": _color(color)}


def line_strip(points_m: Array, color: str) -> dict[str, Any]:
    """Return a line through points (N, 2) on the ground."""
    return {
        "type": LINE_STRIP,
        "pose": ORIGIN,
        "thickness": LINE_PX,
        "scale_invariant": True,
        "points": [{"x": x, "y": y, "z": 0.0} for x, y in points_m.tolist()],
        "color": _color(color),
        "colors": [],
        "indices": [],
    }


def scene_text(text: str, color: str, size_px: float) -> dict[str, Any]:
    """Return a text at the origin of its frame that faces the viewer."""
    return {
        "pose": ORIGIN,
        "billboard": True,
        "font_size": size_px,
        "scale_invariant": True,
        "color": _color(color),
        "text": text,
    }
