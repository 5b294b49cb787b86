"""Compares the labels of a set with what skyherd's own detector finds in the images."""

from dataclasses import dataclass

import numpy as np

from skyherd.datasets.labelled.labels import Labels
from skyherd.datasets.labelled.read import LabelledImage
from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray, wrap_angle
from skyherd.messages import Detections
from skyherd.vision import create_detector

CLEAR_SIDE_PX = 20.0
"""Side from which on a whole marker ought to be found, px. *Chosen*: some 3 px a cell."""

CLEAR_BOUND_PX = 0.05
"""Least standard deviation of position (Cramér–Rao), px, up to which a marker ought to be found. *Chosen*:
blur and noise that allow this leave its bits legible."""

FAR_SIDES = 0.1
"""Share of its side by which a marker may be found off its label, but at least `NEAR_PX`. *Chosen*: far more
than the detector's errors, far less than to another marker."""

NEAR_PX = 1.0
"""Distance by which a marker may always be found off its label, px. *Chosen*: see `FAR_SIDES`."""


@dataclass(frozen=True)
class Agreement:
    """What skyherd's detector finds in a sample of the images, against the truth.

    Attributes:
        images: number of images looked at.
        clear: markers in them that are whole, large and sharp enough to be found.
        found: how many of these were found.
        rmse_px: root mean square error of their positions along one axis; NaN if there are none.
        rmse_deg: root mean square error of their headings.
    """

    images: int
    clear: int
    found: int
    rmse_px: float
    rmse_deg: float

    @property
    def recall(self) -> float:
        """Share of the clear markers that was found; NaN if there are none."""
        return self.found / self.clear if self.clear else float("nan")


def look(images: list[LabelledImage], dictionary: str) -> tuple[Agreement, list[str]]:
    """Detect markers in each image that can be read, and compare them with its labels.

    Returns:
        The agreement over all images, and a line for each image that does not agree.
    """
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
    agreement = Agreement(
        images=int(counts[0]), clear=int(counts[1]), found=len(table), rmse_px=rmse_px, rmse_deg=rmse_deg
    )
    return agreement, doubts


def _compare(labels: Labels, clear: BoolArray, found: Detections) -> tuple[Array, str | None]:
    """Errors (u px, v px, heading deg) of the clear markers found, and what does not agree."""
    _, here, there = np.intersect1d(labels.ids, found.ids, return_indices=True)
    away = found.centers_px[there] - labels.centers_px[here]
    turned = np.degrees(wrap_angle(found.headings_rad[there] - np.radians(labels.headings_deg[here])))
    near = np.linalg.norm(away, axis=1) < np.maximum(NEAR_PX, FAR_SIDES * labels.sides_px[here])
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
