"""YOLO-pose format: one text file per image, one line per marker, and `data.yaml`.

A line is `class u v width height` of the box and `u v visibility` of each keypoint. Coordinates are fractions
of the image's width and height, from its upper left corner. Keypoints outside the image are `0 0 0`.
"""

import numpy as np

from skyherd.datasets.labelled.folder import Folder
from skyherd.datasets.labelled.formats.outlines import bounding_box, visible_outline
from skyherd.datasets.labelled.labels import KEYPOINTS, OUTSIDE, Labels

CLASS = 0
"""Number of the only class, `marker`. Derived: classes count from 0 in `data.yaml`."""

DIGITS = 9
"""Decimals of coordinates, which are fractions of the image's size. Chosen: 1e-6 px in the largest image."""

FLIPPED = (1, 0, 3, 2, 4)
"""Index of the keypoint that each becomes in a mirror image. Derived: left and right are swapped."""


def yolo_text(labels: Labels, size_px: tuple[int, int]) -> str:
    """Return the label file of an image of a size (width, height); empty without markers."""
    return "".join(_line(labels, k, size_px) for k in range(len(labels)))


def _line(labels: Labels, k: int, size_px: tuple[int, int]) -> str:
    """Return the line of one marker, newline included."""
    size, flags = np.array(size_px, dtype=float), labels.visibilities[k]
    left, top, width, height = bounding_box(visible_outline(labels.corners_px[k], size_px))
    box = np.array([left + width / 2, top + height / 2, width, height]) / np.tile(size, 2)
    places = np.where(flags[:, None] == OUTSIDE, 0.0, (labels.keypoints_px[k] + 0.5) / size)
    words = [str(CLASS), *(f"{value:.{DIGITS}f}" for value in box)]
    for (u, v), flag in zip(places, flags, strict=True):
        words += [f"{u:.{DIGITS}f}", f"{v:.{DIGITS}f}", str(flag)]
    return " ".join(words) + "\n"


def folder_yaml(folder: Folder) -> str:
    """Return `data.yaml`: the relative folders of the images, and the keypoints.

    Without images in one split, the file names the other split twice, because YOLO's trainers require both.
    """
    splits = folder.splits()
    return (
        f"# Keypoints: {', '.join(KEYPOINTS)}.\n"
        "# Train with fliplr=0 and flipud=0: the mirror image of a marker is not a marker.\n"
        f"train: images/{splits[0]}\n"
        f"val: images/{splits[-1]}\n"
        f"kpt_shape: [{len(KEYPOINTS)}, 3]\n"
        f"flip_idx: {list(FLIPPED)}\n"
        "names:\n"
        "  0: marker\n"
    )
