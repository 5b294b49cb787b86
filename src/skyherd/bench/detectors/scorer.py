"""Score of a detector: recall, false positives, bias, RMSE compared with the bound, and NEES.

A detection is correct if its id is in the image and its centre is within half a side of that marker's. Each
marker counts once. All other detections are false positives. Markers that are not whole in the image are
ignored in both counts.
"""

from dataclasses import dataclass

import numpy as np

from skyherd.bench.detectors.frames import LabelledFrame
from skyherd.geometry import Array, BoolArray, IntArray, wrap_angle
from skyherd.messages import Detections, Quality


@dataclass(frozen=True)
class Score:
    """A detector's score over some frames; a value is None where it is undefined.

    Attributes:
        images: number of frames.
        markers: whole markers in them.
        found: number of these that were found.
        recall: found over markers.
        false_positives_per_image: detections without a marker, per image.
        bias_px: length of the mean error of (u, v).
        bias_deg: mean error of the heading.
        rmse_px: root mean square error of u and v, per axis, bias included.
        rmse_deg: the same of the heading.
        crb_px, crb_deg: Cramér–Rao bound of the same markers.
        ratio_px, ratio_deg: RMSE over bound.
        nees_u, nees_v, nees_heading: normalised estimation error squared, the mean of error² over the
            reported variance: 1 if the variances are consistent. None if the detector reports none.
        nees: mean of the three.
        photometric: number of markers found that a photometric fit measured (`Quality.PHOTOMETRIC`).
        photometric_ratio_px, photometric_ratio_deg, photometric_nees: ratios and mean NEES of these alone.
    """

    images: int
    markers: int
    found: int
    recall: float | None
    false_positives_per_image: float | None
    bias_px: float | None
    bias_deg: float | None
    rmse_px: float | None
    rmse_deg: float | None
    crb_px: float | None
    crb_deg: float | None
    ratio_px: float | None
    ratio_deg: float | None
    nees_u: float | None
    nees_v: float | None
    nees_heading: float | None
    nees: float | None
    photometric: int
    photometric_ratio_px: float | None
    photometric_ratio_deg: float | None
    photometric_nees: float | None


class Scorer:
    """Accumulated errors of a detector over frames."""

    def __init__(self) -> None:
        self._images, self._markers, self._false = 0, 0, 0
        self._errors: list[Array] = []
        self._bounds: list[Array] = []
        self._variances: list[Array] = []
        self._missed: list[Array] = []
        self._photometric: list[BoolArray] = []

    def add(self, frame: LabelledFrame, detections: Detections) -> None:
        """Compare the detections of one frame with its truth, and accumulate the errors."""
        answers, rows = match(frame, detections)
        wanted = frame.whole[rows]
        self._images += 1
        self._markers += int(frame.whole.sum())
        self._false += len(detections.ids) - len(rows)
        answers, rows = answers[wanted], rows[wanted]
        shift = detections.centers_px[answers] - frame.centers_px[rows]
        turn = wrap_angle(detections.headings_rad[answers] - frame.headings_rad[rows])
        self._errors.append(np.column_stack([shift, turn]))
        self._bounds.append(_variances(frame.bounds[rows]))
        self._variances.append(_variances(detections.covariances[answers]))
        self._missed.append(_variances(np.delete(frame.bounds, rows, axis=0)))
        self._photometric.append(detections.qualities[answers] == Quality.PHOTOMETRIC)

    def score(self) -> Score:
        """Return the score over all frames so far."""
        errors = np.concatenate([np.zeros((0, 3)), *self._errors])
        found = len(errors)
        bounds = np.concatenate([np.zeros((0, 3)), *(self._bounds if found else self._missed)])
        crb_px, crb_rad = _rms_of_variances(bounds)
        rmse_px, rmse_rad = _rms_of_variances(errors**2)
        mean = errors.mean(axis=0) if found else None
        variances = np.concatenate([np.zeros((0, 3)), *self._variances])
        nees = _nees(errors, variances)
        fitted = np.concatenate([np.zeros(0, dtype=bool), *self._photometric])
        fit_nees = _nees(errors[fitted], variances[fitted])
        fit_px, fit_rad = _rms_of_variances(errors[fitted] ** 2)
        fit_crb_px, fit_crb_rad = _rms_of_variances(bounds[fitted] if found else bounds)
        return Score(
            images=self._images,
            markers=self._markers,
            found=found,
            recall=found / self._markers if self._markers else None,
            false_positives_per_image=self._false / self._images if self._images else None,
            bias_px=None if mean is None else float(np.hypot(mean[0], mean[1])),
            bias_deg=None if mean is None else float(np.degrees(mean[2])),
            rmse_px=rmse_px,
            rmse_deg=None if rmse_rad is None else float(np.degrees(rmse_rad)),
            crb_px=crb_px,
            crb_deg=None if crb_rad is None else float(np.degrees(crb_rad)),
            ratio_px=_ratio(rmse_px, crb_px),
            ratio_deg=_ratio(rmse_rad, crb_rad),
            nees_u=None if nees is None else float(nees[0]),
            nees_v=None if nees is None else float(nees[1]),
            nees_heading=None if nees is None else float(nees[2]),
            nees=None if nees is None else float(nees.mean()),
            photometric=int(fitted.sum()),
            photometric_ratio_px=_ratio(fit_px, fit_crb_px),
            photometric_ratio_deg=_ratio(fit_rad, fit_crb_rad),
            photometric_nees=None if fit_nees is None else float(fit_nees.mean()),
        )


def match(frame: LabelledFrame, detections: Detections) -> tuple[IntArray, IntArray]:
    """Return rows (K,) of the correct detections, and rows (K,) of their markers.

    Of several detections of one marker, the nearest is correct, and the others are false positives.
    """
    if not len(frame.ids) or not len(detections.ids):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    order = np.argsort(frame.ids)
    rows = order[np.searchsorted(frame.ids, detections.ids, sorter=order).clip(max=len(order) - 1)]
    away = np.linalg.norm(detections.centers_px - frame.centers_px[rows], axis=1)
    near = np.flatnonzero((frame.ids[rows] == detections.ids) & (away < frame.sides_px[rows] / 2))
    near = near[np.argsort(away[near], kind="stable")]
    _, first = np.unique(rows[near], return_index=True)
    return near[first], rows[near[first]]


def _variances(covariances: Array) -> Array:
    """Return the diagonals (N, 3) of covariances (N, 3, 3)."""
    return np.asarray(np.einsum("nii->ni", covariances.reshape(-1, 3, 3)))


def _rms_of_variances(variances: Array) -> tuple[float | None, float | None]:
    """Return the root of the mean variance (N, 3), per axis of the position and of the heading."""
    if not len(variances):
        return None, None
    return float(np.sqrt(variances[:, :2].mean())), float(np.sqrt(variances[:, 2].mean()))


def _ratio(value: float | None, bound: float | None) -> float | None:
    return None if value is None or not bound else value / bound


def _nees(errors: Array, variances: Array) -> Array | None:
    """Return the mean of error² / variance for each axis (3,); None if a detection has no variance."""
    if not len(errors) or not (variances > 0).all():
        return None
    return np.asarray((errors**2 / variances).mean(axis=0))
