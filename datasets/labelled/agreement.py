"""Comparison of the labels of a set with the detections of skyherd's own detector."""

from dataclasses import dataclass

import numpy as np

from skyherd.datasets.labelled.labels import Labels
from skyherd.datasets.labelled.read import LabelledImage
from skyherd.errors import InputError
from skyherd.geometry import Array, BoolArray, wrap_angle
from skyherd.messages import Detections
from skyherd.vision import create_detector

CLEAR_SIDE_PX = 20.0
"""Side above which the detector should find a whole marker, px. Chosen: about 3 px a cell."""

CLEAR_BOUND_PX = 0.05
"""Cramér–Rao standard deviation of position, px, below which the detector should find a marker. Chosen: bits
are legible under the corresponding blur and noise."""

FAR_SIDES = 0.1
"""Maximum position error, as a share of the marker side, but at least `NEAR_PX`. Chosen: far above the
detector's errors, far below the distance to another marker."""

NEAR_PX = 1.0
"""Position error that is always accepted, px. Chosen: see `FAR_SIDES`."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of skyherd's detector with the ground truth in a sample of images.

    Attributes:
        images: number of images in the sample.
        clear: number of markers in them that are whole, large and sharp enough to be found.
        found: number of these that were found.
        rmse_px: root mean square error of their positions along one axis; NaN without markers.
        rmse_deg: root mean square error of their headings; NaN without markers.
    """

    images: int
    clear: int
    found: int
    rmse_px: float
    rmse_deg: float

    @property
    def recall(self) -> float:
        """Share of the clear markers that was found; NaN without clear markers."""
        return self.found / self.clear if self.clear else float("nan")


def look(images: list[LabelledImage], dictionary: str) -> tuple[Agreement, list[str]]:
    """Detect markers in each readable image, and compare them with its labels.

    Returns:
        The agreement over all images, and one line for each image that disagrees.
    """
    detector = create_detector("photometric", dictionary=dictionary)
    counts, doubts = np.zeros(2, dtype=int), []
    errors: list[Array] = [np.zeros((0, 3))]
    for number, image in enumerate(images):
        try:
            # Each image counts as a camera of its own, because a detector keeps estimates of blur and noise.
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
    """Return the errors (u px, v px, heading deg) of the clear markers found, and a disagreement or None."""
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
    """Return the mask (N,) of the markers that the detector should find."""
    sharp = labels.crb_stds[:, :2].max(axis=1, initial=0.0) < CLEAR_BOUND_PX
    return np.asarray((labels.visible_fractions == 1.0) & (labels.sides_px >= CLEAR_SIDE_PX) & sharp)
