"""COCO keypoint format: one JSON file per split, coordinates in px from the image's upper left corner.

Pixel centres are at halves: u and v are those of the truth table plus 0.5. `bbox`, `segmentation` and `area`
describe the part of the black square inside the image, covered or not. Keypoints outside the image are
`0, 0, 0`.
"""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from skyherd.datasets.labelled.formats.outlines import area, bounding_box, visible_outline
from skyherd.datasets.labelled.labels import KEYPOINTS, OUTSIDE, Labels

Json = dict[str, Any]
"""JSON object."""

CATEGORY = {
    "id": 1,
    "name": "marker",
    "supercategory": "fiducial",
    "keypoints": list(KEYPOINTS),
    "skeleton": [[1, 2], [2, 3], [3, 4], [4, 1], [5, 1], [5, 2]],
}
"""The only category. An annotation's `marker_id` is the marker's id. Keypoints of the skeleton count from
1."""

DIGITS = 6
"""Decimals of coordinates, px. Chosen: a millionth of a pixel, a hundredth of the tolerance of the truth
table."""


COORDINATES = "pixels from the image's upper left corner; pixel centres at halves"
"""Definition of the coordinates, in the file's `info`."""


def coco_text(description: str, size_px: tuple[int, int], images: Sequence[tuple[int, str, Labels]]) -> str:
    """Return the COCO file of a split, as text.

    Args:
        description: description of the set, from its spec.
        size_px: width and height of every image.
        images: number, file name and labels of each image. Annotations are numbered from 1 in this order.
    """
    annotations: list[Json] = []
    for number, _, labels in images:
        for k in range(len(labels)):
            annotations.append(
                {"id": len(annotations) + 1, "image_id": number, **annotation(labels, k, size_px)}
            )
    width, height = size_px
    document = {
        "info": {"description": description, "coordinates": COORDINATES},
        "licenses": [],
        "images": [
            {"id": number, "file_name": name, "width": width, "height": height} for number, name, _ in images
        ],
        "annotations": annotations,
        "categories": [CATEGORY],
    }
    return json.dumps(document)


def annotation(labels: Labels, k: int, size_px: tuple[int, int]) -> Json:
    """Return the annotation of the marker in row k, without its own number and that of its image."""
    outline = visible_outline(labels.corners_px[k], size_px)
    flags = labels.visibilities[k]
    places = np.where(flags[:, None] == OUTSIDE, 0.0, labels.keypoints_px[k] + 0.5).round(DIGITS)
    return {
        "category_id": CATEGORY["id"],
        "iscrowd": 0,
        "bbox": [round(value, DIGITS) for value in bounding_box(outline)],
        "area": round(area(outline), DIGITS),
        "segmentation": [outline.round(DIGITS).ravel().tolist()],
        "num_keypoints": int((flags != OUTSIDE).sum()),
        "keypoints": [
            value
            for (u, v), flag in zip(places.tolist(), flags.tolist(), strict=True)
            for value in (u, v, flag)
        ],
        "marker_id": int(labels.ids[k]),
        "heading_deg": float(labels.headings_deg[k]),
        "visible_fraction": float(labels.visible_fractions[k]),
    }
