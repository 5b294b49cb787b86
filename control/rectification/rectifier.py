"""Self-rectification: detections as from an ideal camera that looks straight down.

The method needs images that are similar to the ground. A real camera has oblong pixels, lens distortion and
tilt. The markers are squares of one size. Their anisotropies and relative sizes in the image determine the
map to the ground up to a similarity, without any calibration (`skyherd.control.rectification.ground_map`).
The map is applied to the detections before the controller uses them:

- information on the camera (pixels, lens, centre, focal length) accumulates over the images. A common change
  of the markers' size may be a zoom, which makes the dependent unknowns less certain;
- the tilt is estimated from each image alone.

An unknown is freed only if its effect is significant (`skyherd.control.rectification.information`).
Detections of an ideal camera therefore pass unchanged, bit by bit. Only corners are used, so that any
detector is sufficient. Anisotropies of single markers are as accurate as the common plane of the photometric
detector, which has no lens model. docs/rectification.md has the law and measurements.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.rectification.ground_fit import (
    CAMERA_PRIOR,
    DIFFERENCE,
    PRIOR,
    SIDES,
    STEPS,
    NoiseStatistics,
    fit_ground,
)
from skyherd.control.rectification.ground_map import (
    CAMERA,
    FOCAL,
    LENS,
    UNKNOWNS,
    GroundMap,
    LocalMaps,
    local_maps,
)
from skyherd.control.rectification.information import Information
from skyherd.control.rectification.square_shapes import Squares, log_sides
from skyherd.geometry import Array, ComplexArray, fit_squares, median, to_complex, to_points
from skyherd.messages import Detections
from skyherd.messages.checks import check_kind

MIN_MARKERS = 3
"""Minimum number of markers of an image that updates the camera, and of the first rectified image. Chosen:
three squares are nine numbers for ten unknowns and a common side."""

MIN_SPREAD = 1e-9
"""Minimum sum of squared distances between centres and their mean, px². Chosen: far below two centres a pixel
apart; it avoids a division by zero for a single marker."""

FRESH_SIDES = 0.02
"""Motion since the last image, in marker sides, below which a marker's weight is proportional to it. Chosen:
a static marker repeats its errors and adds no information."""

CAMERA_MEMORY = 50.0
"""Number of images after which information on the camera has decayed to 1 / e. Chosen: a trade-off between
noise and slowly changing cameras."""

NOISE_MEMORY, NOISE_NUMBERS = 0.98, 10.0
"""Decay factor of the noise statistics per image, a memory of 50 images, and prior degrees of freedom of the
detector's covariances. Chosen: like the camera's memory."""

ZOOM_DEVIATIONS = 4.0
"""Common change of the markers' sizes that counts as a zoom, in standard deviations. Chosen: noise alone
reaches it once in 16 000 images."""

ZOOM_BENDS = 4.0
"""Change of the lens coefficients, prior standard deviations, per e-fold change of focal length. Chosen:
above any lens, as the errors of the steps of a ramp are correlated but added as independent."""


@dataclass
class Rectifier:
    """Rectifier of one unit's detections, which estimates the unit's camera from them.

    Call it once for each image, in order. It keeps the camera's state. A replaced unit starts with a new one.

    Attributes:
        ground_map: map of the last image; the identity before the first.
        camera: information on the camera's unknowns (8,), without the prior.
        noises: statistics of the markers' errors, relative to their covariances.
    """

    ground_map: GroundMap = field(default_factory=GroundMap)
    camera: Information = field(default_factory=lambda: Information.zero(CAMERA))
    noises: NoiseStatistics = field(
        default_factory=lambda: NoiseStatistics(np.full(2, NOISE_NUMBERS), np.full(2, NOISE_NUMBERS))
    )
    _trusted: frozenset[int] = frozenset(range(UNKNOWNS))
    _previous: Squares | None = None
    _log_sides: Array = field(default_factory=lambda: np.zeros(0))

    def rectify(self, seen: Detections) -> Detections:
        """Return the detections as from an ideal camera, and update the camera's estimate.

        The very object `seen` is returned for an ideal camera, for too few markers at the start, and if the
        fit is rejected.
        """
        few = len(seen) < MIN_MARKERS
        if not len(seen) or (few and self._previous is None):
            return seen
        squares = Squares.of(seen)
        camera = self._after_zoom(squares, self.camera + CAMERA_PRIOR)
        fit = fit_ground(
            squares,
            camera=camera,
            start=self.ground_map.unknowns,
            noises=self.noises,
            trusted=self._trusted,
        )
        self.ground_map = GroundMap() if fit is None else fit.ground_map
        if fit is None:
            return seen
        # One image may be an outlier: after the first, an unknown must be significant in two images in a row.
        self._trusted = fit.significant
        if not few:
            fresh = self._fresh(squares)
            kept = (camera - CAMERA_PRIOR).scaled(1 - fresh / CAMERA_MEMORY)
            self.camera = kept + fit.image.marginal(CAMERA).scaled(fresh)
            self.noises = self.noises.accumulated(fit.noises, NOISE_MEMORY)
            self._previous, self._log_sides = squares, self._ground_log_sides(squares)
        return rectified(seen, fit.ground_map)

    def _ground_log_sides(self, squares: Squares) -> Array:
        """Return natural logarithms (N,) of the sides on the ground, by the last map."""
        if self.ground_map.ideal:
            return squares.log_sides
        return squares.log_sides - local_maps(self.ground_map.unknowns, squares.points).log_scales()

    def _after_zoom(self, squares: Squares, camera: Information) -> Information:
        """Return information on the camera (8,), less certain if the focal length has changed.

        A zoom by the factor e^g scales all sides by it. To first order f² changes by 2 g f². If the lens
        bends rays alike at all focal lengths, κ_n changes by 2 n g κ_n, as `κ_n ~ f^(-2n)`.
        """
        if self._previous is None:
            return camera
        here, there = squares.match(self._previous)
        if not here.size:
            return camera
        growth = median(self._ground_log_sides(squares)[here] - self._log_sides[there])
        variances = squares.variances[here] + self._previous.variances[there]
        variance = float(variances.sum() / here.size) / here.size
        factors = self.noises.variance_factors(reported=squares.reported)
        if growth**2 < ZOOM_DEVIATIONS**2 * variance * factors[SIDES]:
            return camera
        changes, lens = np.zeros(CAMERA), self.ground_map.unknowns[LENS]
        changes[FOCAL] = growth * 2.0 * (1 + self.ground_map.unknowns[FOCAL])
        if lens.any():
            bends = np.abs(growth * np.array([2.0, 4.0, 6.0]) * lens)
            changes[LENS] = bends + abs(growth) * ZOOM_BENDS * PRIOR[LENS]
        return camera.diffused(changes**2)

    def _fresh(self, squares: Squares) -> float:
        """Return the mean weight, 0 to 1, of the markers by their motion since the last image."""
        if self._previous is None:
            return 1.0
        here, there = squares.match(self._previous)
        fresh = np.ones(len(squares))
        moved = np.abs(squares.points[here] - self._previous.points[there])
        fresh[here] = np.minimum(1.0, moved / (FRESH_SIDES * np.exp(squares.log_sides[here])))
        return float(fresh.sum() / fresh.size)


def rectified(seen: Detections, ground_map: GroundMap) -> Detections:
    """Return detections with centres, headings, sides, corners and covariances mapped by `ground_map`.

    Corners are mapped. Headings and sides are those of the squares that fit the mapped corners best.

    A detector assumes straight marker edges. A lens that bends them moves a point z of the marker by some
    `B[z, z]`. The centre that fits all edges best is off by the mean of that over the edges. That is about
    half of its mean over the corners. The centre of the mapped corners is off by the same amount in the
    opposite direction. The rectified centre is therefore half-way between the mapped centre and the centre of
    the mapped corners. The two coincide without lens distortion.

    The covariance is the sum of two terms. The first is the covariance of the detection, mapped by the
    derivative at the marker. The second is the covariance of the map, without its part that is a similarity
    of all centres: the ground is known up to one similarity, and goals do not depend on it.
    """
    check_kind("rectified: seen", seen, Detections, "Detections")
    check_kind("rectified: ground_map", ground_map, GroundMap, "a GroundMap")
    if ground_map.ideal:
        return seen
    size, half = seen.image_size_px, seen.image_size_px.min() / 2
    corners = ground_map.rectified_px(seen.corners_px.reshape(-1, 2), size).reshape(-1, 4, 2)
    before, after = (fit_squares(to_complex(c)) for c in (seen.corners_px, corners))
    maps = local_maps(ground_map.unknowns + STEPS, to_complex(seen.centred))
    by_map = _without_similarity(_pose_by_map(maps, half), maps.values[0] * half)
    by_pose = _pose_by_pose(maps.derivatives[0], maps.conjugate_derivatives[0], seen.headings_rad)
    return replace(
        seen,
        centers_px=(to_points(half * maps.values[0]) + (size - 1) / 2 + corners.mean(axis=1)) / 2,
        headings_rad=after.headings_rad(),
        sides_px=seen.sides_px * np.exp(log_sides(after) - log_sides(before)),
        corners_px=corners,
        covariances=by_pose @ seen.covariances @ by_pose.transpose(0, 2, 1)
        + by_map @ ground_map.covariance @ by_map.transpose(0, 2, 1),
    )


def _pose_by_map(maps: LocalMaps, half: float) -> Array:
    """Return derivatives (N, 3, 10) of the rectified (u, v, heading), px and rad, by the unknowns.

    They are differences between maps. The first map is at the unknowns, and each other one has one unknown
    changed by `DIFFERENCE`. A square's heading rotates as the map's derivative does.
    """
    pose = np.stack([half * maps.values.real, half * maps.values.imag, np.angle(maps.derivatives)])
    return np.asarray((pose[:, 1:] - pose[:, :1]).transpose(2, 0, 1) / DIFFERENCE)


def _without_similarity(by_map: Array, centers: ComplexArray) -> Array:
    """Return derivatives (N, 3, 10) of poses without the part that is a similarity of all centres (N,).

    That part is `t + a z`, fitted by least squares, with z the centres relative to their mean. Its rotation,
    the imaginary part of a, is subtracted from the headings.
    """
    z = centers - centers.mean()
    shifts = by_map[:, 0] + 1j * by_map[:, 1]
    shifts = shifts - shifts.mean(axis=0)
    factors = z.conj() @ shifts / max(float(np.sum(np.abs(z) ** 2)), MIN_SPREAD)
    shifts = shifts - z[:, None] * factors
    return np.stack([shifts.real, shifts.imag, by_map[:, 2] - factors.imag], axis=1)


def _pose_by_pose(a: ComplexArray, b: ComplexArray, headings_rad: Array) -> Array:
    """Return derivatives (N, 3, 3) of the rectified (u, v, heading) by the detected pose.

    With `dq = a dp + b dp̄` a direction e^{iθ} is mapped to `m = a e^{iθ} + b e^{-iθ}`. Its angle changes by
    `(|a|² - |b|²) / |m|²` of dθ.
    """
    by_pose = np.zeros((headings_rad.size, 3, 3))
    by_pose[:, :2, 0] = to_points(a + b)
    by_pose[:, :2, 1] = to_points(1j * (a - b))
    ahead = np.exp(1j * headings_rad)
    mapped = a * ahead + b * ahead.conj()
    by_pose[:, 2, 2] = (np.abs(a) ** 2 - np.abs(b) ** 2) / np.abs(mapped) ** 2
    return by_pose
