"""COCO file of a run: its detections as keypoint annotations, and its images if they are recorded.

Coordinates and categories are those of labelled image sets (`skyherd.datasets.labelled.formats.coco`).
"""

import json
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.datasets.labelled.formats.coco import CATEGORY, COORDINATES, annotation
from skyherd.datasets.labelled.formats.outlines import area, visible_outline
from skyherd.datasets.labelled.labels import OUTSIDE, SEEN, Labels
from skyherd.files.atomic import whole_file, write_whole
from skyherd.jobs.progress import Progress
from skyherd.messages import Detections, Quality
from skyherd.recording.export.recorded_run import RecordedRun, Seen

ANNOTATIONS, IMAGES = "annotations.json", "images"
"""Names of the COCO file and of the folder of images."""

MIN_CORNERS = 3
"""Fewest corners of an outline that encloses an area. Defined by geometry."""


def write_coco(run: RecordedRun, folder: Path, progress: Progress) -> dict[str, int]:
    """Write the COCO file and the recorded images; return the numbers of entries.

    The annotations are written as they are read, since those of a long run exceed the memory.

    Args:
        run: the run.
        folder: an existing folder. Its folder of images is replaced.
        progress: receives the time in the run.

    Raises:
        OutputError: a file cannot be written.
    """
    with suppress(FileNotFoundError):
        shutil.rmtree(folder / IMAGES)
    images: list[dict[str, Any]] = []
    markers = pictures = 0
    with whole_file(folder / ANNOTATIONS) as part, part.open("w", encoding="utf-8") as stream:
        head = {
            "info": {"description": f"Detections of the run {run.name}", "coordinates": COORDINATES},
            "licenses": [],
            "categories": [CATEGORY],
        }
        stream.write(f'{json.dumps(head)[:-1]}, "annotations": [')
        for moment in run.moments():
            progress.update(run.name, moment.time_s, run.end_s, f"{moment.time_s:.0f}/{run.end_s:.0f} s")
            if not isinstance(moment, Seen):
                continue
            image = _image(len(images) + 1, moment)
            images.append(image)
            for entry in _annotations(moment.detections, (image["width"], image["height"])):
                markers += 1
                whole = {"id": markers, "image_id": image["id"], **entry}
                stream.write(("," if markers > 1 else "") + "\n" + json.dumps(whole))
            if moment.jpeg is not None:
                pictures += 1
                _write_picture(folder / IMAGES / image["file_name"], moment.jpeg)
        stream.write(f'\n], "images": {json.dumps(images)}}}\n')
    return {"images": len(images), "annotations": markers, "pictures": pictures}


def _image(number: int, seen: Seen) -> dict[str, Any]:
    unit, (width, height) = seen.detections.unit_id, seen.detections.image_size_px.tolist()
    return {
        "id": number,
        "file_name": f"unit_{unit}/{number:06d}.jpg",
        "width": int(width),
        "height": int(height),
        "unit_id": unit,
        "time_s": seen.time_s,
    }


def _write_picture(path: Path, jpeg: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, lambda part: part.write_bytes(jpeg))


def _annotations(found: Detections, size_px: tuple[int, int]) -> Iterator[dict[str, Any]]:
    """Yield an annotation without numbers for each marker that is partly inside the image."""
    labels = _labels(found, size_px)
    for row in range(len(found)):
        if labels.visible_fractions[row] > 0:
            covariance = found.covariances[row]
            yield annotation(labels, row, size_px) | {
                "quality": Quality(found.qualities[row]).name.lower(),
                "covariance": covariance.tolist() if covariance.any() else None,
            }


def _labels(found: Detections, size_px: tuple[int, int]) -> Labels:
    """Return detections as labels. Keypoints inside the image count as visible."""
    points_px = np.concatenate([found.corners_px, found.centers_px[:, None]], axis=1)
    inside = ((points_px >= -0.5) & (points_px <= np.array(size_px) - 0.5)).all(axis=2)
    return Labels(
        ids=found.ids,
        centers_px=found.centers_px,
        headings_deg=np.degrees(found.headings_rad),
        sides_px=found.sides_px,
        corners_px=found.corners_px,
        visible_fractions=np.array([_fraction(corners, size_px) for corners in found.corners_px]),
        visibilities=np.where(inside, SEEN, OUTSIDE).astype(np.int64),
        crb_stds=np.full((len(found), 3), np.nan),
    )


def _fraction(corners_px: np.ndarray, size_px: tuple[int, int]) -> float:
    """Return the share of a marker's area inside the image."""
    outline = visible_outline(corners_px, size_px)
    total = area(corners_px)
    return area(outline) / total if len(outline) >= MIN_CORNERS and total > 0 else 0.0
