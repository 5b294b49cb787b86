"""Preview images in a unit's recording: small, at a low rate, with overlays of markers and goals.

A separate thread makes them, so that the unit never waits. An image that is not finished in time is skipped.
Previews do not affect decisions, and a replay ignores them.
"""

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.control import Decision
from skyherd.drawing.palette import INK, PAPER, UNIT_COLORS
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
}
"""Topics of a unit's previews, and their schemas."""


class FrameLog:
    """Maker of previews at a limited rate, in a separate thread.

    Args:
        unit: number of the unit.
        rate_hz: largest rate of previews, Hz; 0 for none.
        width_px: largest width; wider images are downscaled.
        side_m: side of the markers.
    """

    def __init__(self, unit: int, rate_hz: float, width_px: int, side_m: float) -> None:
        self._unit, self._rate_hz, self._width_px, self._side_m = unit, rate_hz, width_px, side_m
        self._due_s = -np.inf
        self._maker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="frame_log")
        self._made: Future[list[Page]] | None = None

    def show(
        self,
        image: npt.NDArray[np.uint8],
        found: Detections,
        decision: Decision | None = None,
        view: View | None = None,
    ) -> None:
        """Start the preview of an image, unless the last one is too recent or not finished."""
        if self._rate_hz == 0 or self._made is not None or found.time_s < self._due_s:
            return
        self._due_s = found.time_s + 1 / self._rate_hz
        self._made = self._maker.submit(
            pages, self._unit, self._width_px, self._side_m, image, found, decision, view
        )

    def done(self) -> Iterator[Page]:
        """Yield the messages of a finished preview, each once."""
        if self._made is not None and self._made.done():
            made, self._made = self._made, None
            yield from made.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._maker.shutdown(cancel_futures=True)


def pages(
    unit: int,
    width_px: int,
    side_m: float,
    image: npt.NDArray[np.uint8],
    found: Detections,
    decision: Decision | None,
    view: View | None,
) -> list[Page]:
    """Return the messages of one image: preview, overlay, and poses on the ground.

    Args:
        unit: number of the unit.
        width_px: largest width; a wider image is downscaled.
        side_m: side of the markers.
        image: grey levels (height, width).
        found: its markers.
        decision: the unit's decision on it; None without one.
        view: its goals; None without a decision.
    """
    scale = min(1.0, width_px / image.shape[1])
    if scale < 1:
        size = width_px, max(1, round(image.shape[0] * scale))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    picture = foxglove.compressed_image(image, found.time_s, f"unit/{unit}/camera", JPEG_QUALITY)
    overlay = foxglove.Overlay(found.time_s, scale)
    for corners_px, center_px, robot in zip(found.corners_px, found.centers_px, found.ids, strict=True):
        overlay.lines(foxglove.LINE_LOOP, corners_px, MARKER_COLOR)
        overlay.lines(foxglove.LINE_LIST, np.stack([center_px, corners_px[:2].mean(axis=0)]), MARKER_COLOR)
        overlay.text(corners_px[2], str(robot), INK, PAPER)
    if decision is None or view is None:
        return [("/image", picture), ("/overlay", overlay.message)]
    once = found.unambiguous()
    order = np.argsort(once.ids)
    starts_px = once.centers_px[order][rows_of(once.ids[order], view.ids)]
    for start_px, goal_px in zip(starts_px, view.goals_px, strict=True):
        overlay.lines(foxglove.LINE_LIST, np.stack([start_px, goal_px]), GOAL_COLOR)
        overlay.circle(goal_px, GOAL_PX, GOAL_COLOR)
    return [("/image", picture), ("/overlay", overlay.message), ("/poses", _poses(unit, side_m, decision))]


def _poses(unit: int, side_m: float, decision: Decision) -> dict[str, Any]:
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
    return foxglove.frame_transforms(flat.time_s, f"unit/{unit}/ground", places)
