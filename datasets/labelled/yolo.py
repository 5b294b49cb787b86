"""The YOLO-pose layout: a text file an image, a line a marker, and `data.yaml`.

A line is `class u v width height` of the box and `u v visibility` of each keypoint, places over the image's
width and height from its upper left corner; keypoints out of the image are `0 0 0`.
"""

import numpy as np

from skyherd.datasets.labelled.folder import Folder
from skyherd.datasets.labelled.labels import KEYPOINTS, OUTSIDE, Labels
from skyherd.datasets.labelled.outlines import bounding_box, visible_outline
from skyherd.geometry import Array

COLUMNS = 5 + 3 * len(KEYPOINTS)

FLIPPED = (1, 0, 3, 2, 4)
"""Keypoints of a marker's mirror image."""


def yolo_text(labels: Labels, size_px: tuple[int, int]) -> str:
    """The label file of an image; empty if no marker is in it."""
    return "".join(_line(row) for row in yolo_table(labels, size_px))


def yolo_table(labels: Labels, size_px: tuple[int, int]) -> Array:
    """What the lines say, (N, 20)."""
    size, rows = np.array(size_px, dtype=float), np.zeros((len(labels), COLUMNS))
    for k, row in enumerate(rows):
        left, top, width, height = bounding_box(visible_outline(labels.corners_px[k], size_px))
        row[1:5] = np.array([left + width / 2, top + height / 2, width, height]) / np.tile(size, 2)
        flags = labels.visibilities[k]
        places = np.where(flags[:, None] == OUTSIDE, 0.0, (labels.keypoints_px[k] + 0.5) / size)
        row[5:] = np.column_stack([places, flags]).ravel()
    return rows


def _line(row: Array) -> str:
    places = [f"{value:.9f}" for value in row]
    for k in (0, *range(7, COLUMNS, 3)):
        places[k] = str(int(row[k]))
    return " ".join(places) + "\n"


def folder_yaml(folder: Folder) -> str:
    """`data.yaml`: the folders of images, from where it lies, and the keypoints.

    Where a split has no image, the other is named twice: trainers want both.
    """
    splits = folder.splits()
    return (
        f"# Keypoints: {', '.join(KEYPOINTS)}.\n"
        "# Train with fliplr=0 and flipud=0: a marker's mirror image is no marker.\n"
        f"train: images/{splits[0]}\n"
        f"val: images/{splits[-1]}\n"
        f"kpt_shape: [{len(KEYPOINTS)}, 3]\n"
        f"flip_idx: {list(FLIPPED)}\n"
        "names:\n"
        "  0: marker\n"
    )
