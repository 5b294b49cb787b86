"""Preview images in a unit's recording: small, at a low rate, with overlays of markers and goals, and poses.

A separate thread makes them, so that the unit never waits. An image that is not finished in time is skipped.
Previews do not affect decisions, and a replay ignores them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.control import Decision
from skyherd.drawing.palette import INK, PAPER, UNIT_COLORS
from skyherd.jobs.background import BackgroundWorker
from skyherd.live.logs.marker_poses import MarkerPoses, PoseMeter
from skyherd.live.logs.view import View
from skyherd.messages import Detections, rows_of
from skyherd.poses import ground_positions
from skyherd.recording import foxglove
from skyherd.recording.mcap_log import Schema

JPEG_QUALITY = 70
"""JPEG quality of the previews, %. Chosen: markers and numbers are clearly visible; 35 % shows block
artefacts, and 90 % doubles the size."""

MARKER_COLOR, GOAL_COLOR = UNIT_COLORS[2], UNIT_COLORS[1]
"""Colours of detected markers and of goals."""

GOAL_PX = 10.0
"""Diameter of the circle at a goal, px of the preview."""

Page = tuple[str, Any]
"""A topic and a message for it."""

TOPICS: dict[str, Schema] = {
    "/image": foxglove.IMAGE,
    "/overlay": foxglove.ANNOTATIONS,
    "/poses": foxglove.TRANSFORMS,
    "/marker_poses": ("skyherd.MarkerPoses", MarkerPoses),
}
"""Topics of a unit's previews, and their schemas."""


@dataclass(frozen=True)
class Sight:
    """One image with what the unit made of it.

    Attributes:
        image: grey levels (height, width).
        markers: the markers in it.
        robots: the robots in it.
        decision: the unit's decision on it; None without one.
        view: goals of the decision; None without one.
    """

    image: npt.NDArray[np.uint8]
    markers: Detections
    robots: Detections
    decision: Decision | None = None
    view: View | None = None


class FrameLog:
    """Maker of previews at a limited rate, in a separate thread.

    Attributes:
        trouble: why the last image has no poses of markers, or None.

    Args:
        unit: number of the unit.
        rate_hz: largest rate of previews, Hz; 0 for none.
        width_px: largest width; wider images are downscaled.
        side_m: side of the markers.
        meter: measures poses of the markers; None for a camera without calibration.
    """

    def __init__(
        self, unit: int, rate_hz: float, width_px: int, side_m: float, meter: PoseMeter | None = None
    ) -> None:
        self._unit, self._rate_hz, self._width_px, self._side_m = unit, rate_hz, width_px, side_m
        self._meter, self._due_s = meter, -np.inf
        self.trouble: str | None = None
        self._maker: BackgroundWorker[list[Page]] = BackgroundWorker("frame_log")

    def show(self, sight: Sight) -> None:
        """Start the preview of an image, unless the last one is too recent or not finished."""
        time_s = sight.markers.time_s
        if self._rate_hz == 0 or not self._maker.is_free or time_s < self._due_s:
            return
        self._due_s = time_s + 1 / self._rate_hz
        if self._meter is not None:
            self.trouble = self._meter.trouble(sight.image)
        meter = None if self.trouble else self._meter
        self._maker.start(pages, self._unit, self._width_px, self._side_m, sight, meter)

    def done(self) -> Iterator[Page]:
        """Yield the messages of a finished preview, each once."""
        yield from self._maker.take() or ()

    def __enter__(self) -> Self:
        self._maker.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._maker.__exit__(kind, error, trace)


def pages(
    unit: int, width_px: int, side_m: float, sight: Sight, meter: PoseMeter | None = None
) -> list[Page]:
    """Return the messages of one image: preview, overlay, poses on the ground and in the camera's axes.

    Args:
        unit: number of the unit.
        width_px: largest width; a wider image is downscaled.
        side_m: side of the markers.
        sight: the image.
        meter: measures the poses in the camera's axes; None for none.
    """
    picture, overlay = _picture(unit, width_px, sight)
    found: list[Page] = [("/image", picture), ("/overlay", overlay)]
    transforms = [] if sight.decision is None else _ground_poses(unit, side_m, sight.decision)
    if meter is not None:
        poses = meter.poses(sight.image, sight.markers)
        found.append(("/marker_poses", poses))
        transforms += _camera_poses(unit, poses)
    if sight.decision is not None or meter is not None:
        found.append(("/poses", {"transforms": transforms}))
    return found


def _picture(unit: int, width_px: int, sight: Sight) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the preview of an image, and its overlay of markers and ways to goals."""
    image, robots, view = sight.image, sight.robots, sight.view
    scale = min(1.0, width_px / image.shape[1])
    if scale < 1:
        size = width_px, max(1, round(image.shape[0] * scale))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    picture = foxglove.compressed_image(image, robots.time_s, f"unit/{unit}/camera", JPEG_QUALITY)
    overlay = foxglove.Overlay(robots.time_s, scale)
    for corners_px, center_px, robot in zip(robots.corners_px, robots.centers_px, robots.ids, strict=True):
        overlay.lines(foxglove.LINE_LOOP, corners_px, MARKER_COLOR)
        overlay.lines(foxglove.LINE_LIST, np.stack([center_px, corners_px[:2].mean(axis=0)]), MARKER_COLOR)
        overlay.text(corners_px[2], str(robot), INK, PAPER)
    if view is not None:
        once = robots.unambiguous()
        order = np.argsort(once.ids)
        starts_px = once.centers_px[order][rows_of(once.ids[order], view.ids)]
        for start_px, goal_px in zip(starts_px, view.goals_px, strict=True):
            overlay.lines(foxglove.LINE_LIST, np.stack([start_px, goal_px]), GOAL_COLOR)
            overlay.circle(goal_px, GOAL_PX, GOAL_COLOR)
    return picture, overlay.message


def _ground_poses(unit: int, side_m: float, decision: Decision) -> list[dict[str, Any]]:
    """Return the robots' poses on the ground, m and rad, as estimated by the unit."""
    flat = decision.detections.unambiguous()
    places = {
        f"unit/{unit}/robot/{robot}": (x, y, 0.0, -heading_rad)
        for robot, (x, y), heading_rad in zip(
            flat.ids.tolist(),
            ground_positions(flat, side_m).tolist(),
            flat.headings_rad.tolist(),
            strict=True,
        )
    }
    return list(foxglove.frame_transforms(flat.time_s, f"unit/{unit}/ground", places)["transforms"])


def _camera_poses(unit: int, poses: MarkerPoses) -> list[dict[str, Any]]:
    """Return the markers' poses in the camera's axes."""
    parts = zip(poses.ids.tolist(), poses.positions_m.tolist(), poses.quaternions.tolist(), strict=True)
    return [
        foxglove.frame_transform(
            poses.captured_s, f"unit/{unit}/camera", f"unit/{unit}/marker/{marker}", position_m, quaternion
        )
        for marker, position_m, quaternion in parts
    ]
