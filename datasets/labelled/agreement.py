"""Whether labels are where skyherd's detector sees the markers."""

from dataclasses import dataclass

import numpy as np

from skyherd.datasets.labelled.labels import Labels
from skyherd.datasets.labelled.read import LabelledImage
from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray, wrap_angle
from skyherd.messages import Detections
from skyherd.vision import create_detector

CLEAR_SIDE_PX, CLEAR_BOUND_PX = 20.0, 0.05
"""Markers at least so large, whole, and that can be measured so well ought to be found."""

FAR_SIDES = 0.1
"""A marker found so far from its label, and a pixel, is not where that says."""


@dataclass(frozen=True)
class Agreement:
    """What skyherd's detector finds in a sample of the images, against the truth.

    Attributes:
        images: looked at.
        clear: whole markers, large and sharp enough, there.
        found: of these.
        rmse_px: of position, over the found; NaN if there are none.
        rmse_deg: of heading.
    """

    images: int
    clear: int
    found: int
    rmse_px: float
    rmse_deg: float

    @property
    def recall(self) -> float:
        """Share of the clear markers that is found."""
        return self.found / self.clear if self.clear else float("nan")


def look(images: list[LabelledImage], dictionary: str) -> tuple[Agreement, list[str]]:
    """Detect in each image that can be read, and compare; what does not agree is a line each."""
    detector = create_detector("photometric", dictionary=dictionary)
    counts, doubts = np.zeros(2, dtype=int), []
    errors: list[Array] = [np.zeros((0, 3))]
    for number, image in enumerate(images):
        try:
            # As if by a camera of its own: a detector remembers a camera's blur and noise.
            found = detector.detect(image.read(), unit_id=number)
        except InputError:
            continue
        clear = _clear(image.labels)
        off, doubt = _compare(image.labels, clear, found)
        errors.append(off)
        counts += (1, clear.sum())
        if doubt:
            doubts.append(f"{image.path}: {doubt}")
    table = np.concatenate(errors)
    square = (table**2).mean(axis=0) if len(table) else np.full(3, np.nan)
    rmse_px, rmse_deg = float(np.sqrt(square[:2].mean())), float(np.sqrt(square[2]))
    return Agreement(int(counts[0]), int(counts[1]), len(table), rmse_px, rmse_deg), doubts


def _compare(labels: Labels, clear: BoolArray, found: Detections) -> tuple[Array, str | None]:
    """Errors (u px, v px, heading deg) of the clear markers found, and what does not agree."""
    _, here, there = np.intersect1d(labels.ids, found.ids, return_indices=True)
    away = found.centers_px[there] - labels.centers_px[here]
    turned = np.degrees(wrap_angle(found.headings_rad[there] - np.radians(labels.headings_deg[here])))
    near = np.linalg.norm(away, axis=1) < np.maximum(1.0, FAR_SIDES * labels.sides_px[here])
    kept = near & clear[here]
    off = np.column_stack([away, turned])[kept]
    if astray := labels.ids[here][~near & clear[here]].tolist():
        return off, f"markers {astray} are not where their labels are"
    strangers = np.setdiff1d(found.ids, labels.ids).tolist()
    if len(strangers) > near.sum():
        return off, f"markers {strangers} are seen in it, which have no label"
    return off, None


def _clear(labels: Labels) -> BoolArray:
    """Which markers ought to be found (N,)."""
    sharp = labels.crb_stds[:, :2].max(axis=1, initial=0.0) < CLEAR_BOUND_PX
    return np.asarray((labels.visible_fractions == 1.0) & (labels.sides_px >= CLEAR_SIDE_PX) & sharp)
