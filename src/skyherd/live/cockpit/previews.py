"""Pictures of the units for the page: files in the folder of the run, which the session reads.

A unit writes them in a separate thread, so that it never waits. A picture that is not finished in time is
skipped.
"""

import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import TypeAdapter

from skyherd.drawing.canvas import draw_segments
from skyherd.drawing.palette import unit_rgb
from skyherd.errors import OutputError
from skyherd.files.atomic import write_text, write_whole
from skyherd.inspection import Annotator
from skyherd.jobs.background import BackgroundWorker
from skyherd.live.logs.view import View
from skyherd.messages import Detections, rows_of

PREVIEWS = "preview"
"""Name of the folder of pictures in the folder of a run."""

PERIOD_S = 0.5
"""Shortest time between two pictures, s. Chosen: operators see what happens, for some per cent of a core."""

WIDTH_PX = 640
"""Largest width of a picture, px. Chosen: wider than a column of the page."""

JPEG_QUALITY = 70
"""JPEG quality, %. Chosen as for the previews of recordings."""


@dataclass(frozen=True)
class Preview:
    """Robots that a unit saw and controls in one image.

    Attributes:
        unit: number of the unit.
        seen: robots in the image.
        sides_px: shortest and longest side of their markers, px of the camera's image; empty without any.
        controlled: robots that the unit controls.
        trouble: fault of the image, or an empty string.
    """

    unit: int
    seen: list[int]
    sides_px: list[float]
    controlled: list[int]
    trouble: str = ""


class PreviewWriter:
    """Writer of a unit's pictures.

    Args:
        folder: folder of the pictures; made if it is missing. None: nothing is written.
        unit: number of the unit.
    """

    def __init__(self, folder: Path | None, unit: int) -> None:
        self._folder, self._unit = folder, unit
        self._due_s = -np.inf
        self._maker: BackgroundWorker[None] = BackgroundWorker("preview")
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def show(
        self, image: npt.NDArray[np.uint8], found: Detections, view: View | None, trouble: str | None
    ) -> None:
        """Start the picture of an image (height, width), unless the last is too recent or not finished."""
        self._maker.take()
        if self._folder is None or not self._maker.is_free or time.monotonic() < self._due_s:
            return
        self._due_s = time.monotonic() + PERIOD_S
        self._maker.start(_write, self._folder, self._unit, image, found, view, trouble or "")

    def __enter__(self) -> Self:
        self._maker.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._maker.__exit__(kind, error, trace)


def _write(
    folder: Path,
    unit: int,
    image: npt.NDArray[np.uint8],
    found: Detections,
    view: View | None,
    trouble: str,
) -> None:
    """Write picture and record of an image. A full disk ends neither the unit nor its recording."""
    once = found.unambiguous()
    sides_px = [float(once.sides_px.min()), float(once.sides_px.max())] if len(once) else []
    controlled = [] if view is None else sorted(view.ids.tolist())
    preview = Preview(unit, sorted(once.ids.tolist()), sides_px, controlled, trouble)
    picture = draw(image, once, view, unit)
    done, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert done
    try:
        write_whole(picture_path(folder, unit), lambda part: part.write_bytes(jpeg.tobytes()))
        write_text(_record_path(folder, unit), json.dumps(asdict(preview)))
    except OutputError:
        return


def draw(
    image: npt.NDArray[np.uint8], once: Detections, view: View | None, unit: int
) -> npt.NDArray[np.uint8]:
    """Return a picture (H, W, 3), RGB, at most `WIDTH_PX` wide, with markers, their ids, and ways to goals.

    Args:
        image: grey levels (height, width).
        once: the robots in it, each once.
        view: goals of the unit, or None.
        unit: number of the unit, for its colour.
    """
    scale = min(1.0, WIDTH_PX / image.shape[1])
    size_px = round(image.shape[1] * scale), max(1, round(image.shape[0] * scale))
    small = np.asarray(cv2.resize(image, size_px, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    shift = (scale - 1) / 2  # Pixel centres have integer coordinates.
    scaled = replace(
        once,
        image_size_px=np.array(size_px),
        centers_px=once.centers_px * scale + shift,
        corners_px=once.corners_px * scale + shift,
        sides_px=once.sides_px * scale,
    )
    annotator = Annotator(size_px, min_side_px=1)
    picture = annotator.draw(small, scaled)
    if view is not None and view.ids.size:
        order = np.argsort(once.ids)
        starts_px = scaled.centers_px[order][rows_of(once.ids[order], view.ids)]
        draw_segments(picture, starts_px, view.goals_px * scale + shift, unit_rgb(unit), annotator.line_px)
    return picture


def picture_path(folder: Path, unit: int) -> Path:
    """Return the path of the newest picture of a unit."""
    return folder / f"unit_{unit}.jpg"


def _record_path(folder: Path, unit: int) -> Path:
    return folder / f"unit_{unit}.json"


def read_preview(folder: Path, unit: int) -> tuple[Preview, float] | None:
    """Return what a unit saw last, and its age, s; None without a readable record."""
    path = _record_path(folder, unit)
    try:
        age_s = max(0.0, time.time() - path.stat().st_mtime)
        return TypeAdapter(Preview).validate_json(path.read_bytes()), age_s
    except (OSError, ValueError):
        return None
