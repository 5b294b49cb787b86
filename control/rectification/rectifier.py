"""Self-rectification: detections as an ideal camera that looks straight down would have given them.

The method needs images that are similar to the ground; a real camera has oblong pixels, a lens and a tilt.
The markers are squares of one size: how each is squeezed in the image, and how large it is beside the others,
determines the map to the ground up to a similarity (`skyherd.control.rectification.ground_map`), without any
calibration. The map is applied to the detections before the controller sees them:

- information on the camera (pixels, lens, centre, focal length) accumulates from image to image. A common
  change of the markers' size may be a zoom, after which the unknowns that depend on it are less certain;
- the tilt is estimated from each image alone.

An unknown is freed only where it explains what cannot be noise (`skyherd.control.rectification.information`),
so that the detections of an ideal camera pass unchanged, to the bit. Only corners are used, so that any
detector will do: squeezes of single markers are as good as the common plane of the photometric detector,
which knows no lens. docs/rectification.md has the law and measurements.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.rectification.ground_fit import (
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
from skyherd.geometry import Array, ComplexArray, fit_squares, to_complex, to_points
from skyherd.messages import Detections, centred
from skyherd.messages.checks import check_kind

MIN_MARKERS = 3
"""An image with fewer markers does not change what is known of the camera; and before an image with so many
was seen, detections pass unchanged. Chosen: three squares are nine numbers for ten unknowns and a common
side."""

MIN_SPREAD = 1e-9
"""Lower limit of the sum of squared distances between centres and their mean, px². Chosen: far below that of
two centres a pixel apart; it avoids a division by zero for a single marker."""

FRESH_SIDES = 0.02
"""A marker that moved by less than this since the last image, in its sides, counts in proportion to its
motion. Chosen: a marker that stands still in the image repeats its errors, and adds no information."""

CAMERA_MEMORY = 50.0
"""Number of images after which information on the camera has faded to 1 / e. Chosen: a trade-off between
noise and cameras that change slowly."""

NOISE_MEMORY, NOISE_NUMBERS = 0.98, 10.0
"""Share of the noise statistics that is kept from image to image, which is a memory of 50 images; and the
degrees of freedom that the detector's covariances count as before the first image. Chosen, as the camera's
memory."""

ZOOM_DEVIATIONS = 4.0
"""Common change of the markers' sizes that counts as a zoom, in standard deviations. Chosen: noise alone
reaches it once in 16 000 images."""

ZOOM_BENDS = 4.0
"""Change of the lens' coefficients, in prior standard deviations, for a change of the focal length by a
factor of e, since a zoom lens bends differently at each focal length. Chosen larger than any lens has: in a
ramp the changes of single steps have one sign, while the model adds them as if they were independent."""


@dataclass
class Rectifier:
    """Rectifies one unit's detections, and estimates its camera from them.

    It is to be called once for each image, in order. It keeps the camera's state; a unit that is replaced
    begins with a new one.

    Attributes:
        ground_map: map of the last image; the identity before the first.
        camera: information on the camera's unknowns (8,), without the prior.
        noises: statistics of how much the markers err, relative to their covariances.
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
        """The detections as an ideal camera would have given them; the camera's estimate is updated.

        The very object `seen` is returned where nothing is to be changed: for an ideal camera, for too few
        markers at the start, and where no camera fits what is seen.
        """
        few = len(seen) < MIN_MARKERS
        if not len(seen) or (few and self._previous is None):
            return seen
        squares = Squares.of(seen)
        prior = Information.prior(PRIOR[:CAMERA])
        camera = self._after_zoom(squares, self.camera + prior)
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
        # An image may be misread: after the first, an unknown must be significant in two images running.
        self._trusted = fit.significant
        if not few:
            fresh = self._fresh(squares)
            kept = (camera - prior).scaled(1 - fresh / CAMERA_MEMORY)
            self.camera = kept + fit.image.marginal(CAMERA).scaled(fresh)
            self.noises = self.noises.accumulated(fit.noises, NOISE_MEMORY)
            self._previous, self._log_sides = squares, self._ground_log_sides(squares)
        return rectified(seen, fit.ground_map)

    def _ground_log_sides(self, squares: Squares) -> Array:
        """Natural logarithms (N,) of the sides on the ground, by the last map."""
        if self.ground_map.ideal:
            return squares.log_sides
        return squares.log_sides - local_maps(self.ground_map.unknowns, squares.points).log_scales()

    def _after_zoom(self, squares: Squares, camera: Information) -> Information:
        """Information on the camera (8,), less certain where the focal length has changed.

        A zoom by the factor e^g makes all sides grow by it. To first order f² changes by 2 g f² and, if the
        lens bends rays alike at all focal lengths, κ_n by 2 n g κ_n, as `κ_n ~ f^(-2n)`.
        """
        if self._previous is None:
            return camera
        here, there = squares.match(self._previous)
        if not here.size:
            return camera
        growth = float(np.median(self._ground_log_sides(squares)[here] - self._log_sides[there]))
        variance = float(np.mean(squares.variances[here] + self._previous.variances[there])) / here.size
        factors = self.noises.variance_factors(reported=squares.reported)
        if growth**2 < ZOOM_DEVIATIONS**2 * variance * factors[SIDES]:
            return camera
        changes = np.zeros(CAMERA)
        changes[FOCAL] = growth * 2.0 * (1 + self.ground_map.unknowns[FOCAL])
        changes[LENS] = growth * np.array([2.0, 4.0, 6.0]) * self.ground_map.unknowns[LENS]
        if self.ground_map.unknowns[LENS].any():
            changes[LENS] = np.abs(changes[LENS]) + abs(growth) * ZOOM_BENDS * PRIOR[LENS]
        return camera.diffused(changes**2)

    def _fresh(self, squares: Squares) -> float:
        """Mean over the markers of the share, 0 to 1, by which each has moved enough to add information."""
        if self._previous is None:
            return 1.0
        here, there = squares.match(self._previous)
        fresh = np.ones(len(squares))
        moved = np.abs(squares.points[here] - self._previous.points[there])
        fresh[here] = np.minimum(1.0, moved / (FRESH_SIDES * np.exp(squares.log_sides[here])))
        return float(fresh.mean())


def rectified(seen: Detections, ground_map: GroundMap) -> Detections:
    """Detections with centres, headings, sides, corners and covariances mapped by `ground_map`.

    Corners are mapped; headings and sides are those of the squares that fit the mapped corners best.

    A detector takes the edges of a marker for straight. Where a lens bends them, it moves a point z of the
    marker by some `B[z, z]`, and the centre that fits all edges best is off by the mean of that over the
    edges. That is about half of its mean over the corners, by which the centre of the mapped corners is off
    in the opposite direction. The rectified centre is therefore half-way between the mapped centre and the
    centre of the mapped corners; the two coincide where no lens bends.

    The covariance is the sum of two: that of the detection, mapped by the derivative at the marker; and that
    of the map, less what is a similarity of all centres, since the ground is known up to one similarity and
    no goal depends on it.
    """
    check_kind("rectified: seen", seen, Detections, "Detections")
    check_kind("rectified: ground_map", ground_map, GroundMap, "a GroundMap")
    if ground_map.ideal:
        return seen
    size, half = seen.image_size_px, seen.image_size_px.min() / 2
    corners = ground_map.rectified_px(seen.corners_px.reshape(-1, 2), size).reshape(-1, 4, 2)
    before, after = (fit_squares(to_complex(c)) for c in (seen.corners_px, corners))
    maps = local_maps(ground_map.unknowns + STEPS, to_complex(centred(seen.centers_px, size)))
    by_map = _but_for_similarity(_pose_by_map(maps, half), maps.values[0] * half)
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
    """Derivatives (N, 3, 10) of the rectified (u, v, heading), px and rad, by the unknowns.

    They are differences between maps, of which the first is at the unknowns, and each other one has one
    unknown changed by `DIFFERENCE`. A square's heading rotates as the map's derivative does.
    """
    pose = np.stack([half * maps.values.real, half * maps.values.imag, np.angle(maps.derivatives)])
    return np.asarray((pose[:, 1:] - pose[:, :1]).transpose(2, 0, 1) / DIFFERENCE)


def _but_for_similarity(by_map: Array, centers: ComplexArray) -> Array:
    """Derivatives (N, 3, 10) of poses less the part that is a similarity of all centres (N,).

    That part is `t + a z`, fitted by least squares, z being the centres relative to their mean; its rotation,
    the imaginary part of a, is taken off the headings.
    """
    z = centers - centers.mean()
    shifts = by_map[:, 0] + 1j * by_map[:, 1]
    shifts = shifts - shifts.mean(axis=0)
    factors = z.conj() @ shifts / max(float(np.sum(np.abs(z) ** 2)), MIN_SPREAD)
    shifts = shifts - z[:, None] * factors
    return np.stack([shifts.real, shifts.imag, by_map[:, 2] - factors.imag], axis=1)


def _pose_by_pose(a: ComplexArray, b: ComplexArray, headings_rad: Array) -> Array:
    """Derivatives (N, 3, 3) of the rectified (u, v, heading) by the one detected.

    With `dq = a dp + b dp̄` a direction e^{iθ} is mapped to `m = a e^{iθ} + b e^{-iθ}`, whose angle changes by
    `(|a|² - |b|²) / |m|²` of dθ.
    """
    by_pose = np.zeros((headings_rad.size, 3, 3))
    by_pose[:, :2, 0] = to_points(a + b)
    by_pose[:, :2, 1] = to_points(1j * (a - b))
    ahead = np.exp(1j * headings_rad)
    mapped = a * ahead + b * ahead.conj()
    by_pose[:, 2, 2] = (np.abs(a) ** 2 - np.abs(b) ** 2) / np.abs(mapped) ** 2
    return by_pose
