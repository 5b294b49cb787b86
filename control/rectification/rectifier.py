"""Self-rectification: detections as an ideal camera that looks straight down would have given them.

The markers are squares of one size: how each is squeezed in the image, and how large it is beside the others,
tells the map to the ground (`skyherd.control.rectification.ground_map`), with no calibration:

- what belongs to the camera, squeeze, lens, centre and focal length, gathers evidence from image to image;
  a common change of the markers' size may be a zoom, and loosens what depends on the focal length;
- the tilt is of each image alone.

What cannot be told from noise is left as it is, so that an ideal camera's detections pass unchanged.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from skyherd.control.rectification.ground_fit import DIFFERENCE, PRIOR, SIDES, STEPS, Noises, fit_ground
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

LEAST_MARKERS = 3
"""Fewer tell nothing of a camera, and change nothing before one was learned."""

LEAST_SPREAD = 1e-9
"""Squares of distances, px², that centres in one place are taken to have."""

FRESH_SIDES = 0.02
"""A marker that moved less, in its sides, since the last image repeats errors, and counts in proportion."""

CAMERA_MEMORY = 50.0
"""So many images' evidence on the camera is kept."""

NOISE_MEMORY, NOISE_NUMBERS = 0.98, 10.0
"""What of the noise is kept from image to image; how many numbers the detector's word is worth at first."""

ZOOM_DEVIATIONS = 4.0
"""The markers have changed size together if by more than so many deviations."""

ZOOM_BENDS = 4.0
"""A zoom lens bends otherwise at each focal length: by so many prior deviations where that grows by e. In
steps of a ramp these changes are of one sign, so that more than a lens has is allowed for each."""


@dataclass
class Rectifier:
    """Learns one unit's camera, and rectifies its detections.

    Attributes:
        ground_map: of the last image.
        learned: evidence on the camera's unknowns.
        noises: how much more the markers err than their covariance says.
    """

    ground_map: GroundMap = field(default_factory=GroundMap)
    learned: Information = field(default_factory=lambda: Information.none(CAMERA))
    noises: Noises = field(
        default_factory=lambda: Noises(np.full(2, NOISE_NUMBERS), np.full(2, NOISE_NUMBERS))
    )
    _trusted: frozenset[int] = frozenset(range(UNKNOWNS))
    _before: Squares | None = None
    _log_sides: Array = field(default_factory=lambda: np.zeros(0))

    def rectify(self, seen: Detections) -> Detections:
        """The detections as an ideal camera would have given them; learns from them on the way."""
        few = len(seen) < LEAST_MARKERS
        if not len(seen) or (few and self._before is None):
            return seen
        squares = Squares.of(seen)
        prior = Information.prior(PRIOR[:CAMERA])
        camera = self._loosened(squares, self.learned + prior)
        fit = fit_ground(squares, camera, self.ground_map.unknowns, self.noises, self._trusted)
        self.ground_map = GroundMap() if fit is None else fit.ground_map
        if fit is None:
            return seen
        # One image may be misread: after the first, what it has to tell must be told twice running.
        self._trusted = fit.earned
        if not few:
            fresh = self._fresh(squares)
            kept = (camera - prior).times(1 - fresh / CAMERA_MEMORY)
            self.learned = kept + fit.image.first(CAMERA).times(fresh)
            self.noises = self.noises.and_then(fit.noises, NOISE_MEMORY)
            self._before, self._log_sides = squares, self._ground_log_sides(squares)
        return rectified(seen, fit.ground_map)

    def _ground_log_sides(self, squares: Squares) -> Array:
        """Logarithms of the sides (N,) as the last map has them."""
        if self.ground_map.ideal:
            return squares.log_sides
        return squares.log_sides - local_maps(self.ground_map.unknowns, squares.points).log_scales()

    def _loosened(self, squares: Squares, camera: Information) -> Information:
        """The camera, less what a zoom has changed: sides grow as f does, and `κ_n ~ f^(-2n)` or more."""
        if self._before is None:
            return camera
        here, there = squares.match(self._before)
        if not here.size:
            return camera
        growth = float(np.median(self._ground_log_sides(squares)[here] - self._log_sides[there]))
        variance = float(np.mean(squares.variances[here] + self._before.variances[there])) / here.size
        if growth**2 < ZOOM_DEVIATIONS**2 * variance * self.noises.excess(told=squares.told)[SIDES]:
            return camera
        changes = np.zeros(CAMERA)
        changes[FOCAL] = growth * 2.0 * (1 + self.ground_map.unknowns[FOCAL])
        changes[LENS] = growth * np.array([2.0, 4.0, 6.0]) * self.ground_map.unknowns[LENS]
        if self.ground_map.unknowns[LENS].any():
            changes[LENS] = np.abs(changes[LENS]) + abs(growth) * ZOOM_BENDS * PRIOR[LENS]
        return camera.loosened(changes**2)

    def _fresh(self, squares: Squares) -> float:
        """Mean share by which the markers tell something new."""
        if self._before is None:
            return 1.0
        here, there = squares.match(self._before)
        fresh = np.ones(len(squares))
        moved = np.abs(squares.points[here] - self._before.points[there])
        fresh[here] = np.minimum(1.0, moved / (FRESH_SIDES * np.exp(squares.log_sides[here])))
        return float(fresh.mean())


def rectified(seen: Detections, ground_map: GroundMap) -> Detections:
    """Detections through a map, with covariances.

    Corners are mapped; headings and sides are those of the squares that fit the mapped corners. A detector
    takes a marker for flat squares that no lens bends. Where one does, the bend moves a point z of the marker
    by some `B[z, z]`, and what fits all edges best is off by the mean of that over the edges: about half of
    the mean over the corners, by which the middle of the mapped corners is off the other way. So the centre
    is put half-way between the mapped centre and that middle, which are one where no lens bends.
    The covariance is the detection's through the map's slope at the marker, and the map's own but for a
    similarity of all centres: the ground is known up to one, and no goal depends on it.
    """
    if ground_map.ideal:
        return seen
    size, half = seen.image_size_px, seen.image_size_px.min() / 2
    corners = ground_map.rectified_px(seen.corners_px.reshape(-1, 2), size).reshape(-1, 4, 2)
    before, after = (fit_squares(to_complex(c)) for c in (seen.corners_px, corners))
    maps = local_maps(ground_map.unknowns + STEPS, to_complex(centred(seen.centers_px, size)))
    by_map = _but_for_similarity(_pose_by_map(maps, half), maps.values[0] * half)
    by_pose = _pose_by_pose(maps.slopes[0], maps.crosses[0], seen.headings_rad)
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
    """Derivatives (N, 3, 10) of (u, v, heading) by the unknowns, from maps with each of them stepped.

    A square's heading turns as the map's slope does.
    """
    pose = np.stack([half * maps.values.real, half * maps.values.imag, np.angle(maps.slopes)])
    return np.asarray((pose[:, 1:] - pose[:, :1]).transpose(2, 0, 1) / DIFFERENCE)


def _but_for_similarity(by_map: Array, centers: ComplexArray) -> Array:
    """What is left of derivatives (N, 3, 10) of poses but for the similarities of all `centers` (N,) in them.

    Those are `t + a z` by least squares, z being the centres from their mean; a turns headings by its angle.
    """
    z = centers - centers.mean()
    shifts = by_map[:, 0] + 1j * by_map[:, 1]
    shifts = shifts - shifts.mean(axis=0)
    turns = z.conj() @ shifts / max(float(np.sum(np.abs(z) ** 2)), LEAST_SPREAD)
    shifts = shifts - z[:, None] * turns
    return np.stack([shifts.real, shifts.imag, by_map[:, 2] - turns.imag], axis=1)


def _pose_by_pose(slopes: ComplexArray, crosses: ComplexArray, headings_rad: Array) -> Array:
    """Derivatives (N, 3, 3) of a rectified (u, v, heading) by the one seen.

    A direction e^{iθ} is mapped to `a e^{iθ} + b e^{-iθ}`, which turns by `(|a|² - |b|²) / |·|²` of dθ.
    """
    by_pose = np.zeros((headings_rad.size, 3, 3))
    by_pose[:, :2, 0] = to_points(slopes + crosses)
    by_pose[:, :2, 1] = to_points(1j * (slopes - crosses))
    ahead = np.exp(1j * headings_rad)
    mapped = slopes * ahead + crosses * ahead.conj()
    by_pose[:, 2, 2] = (np.abs(slopes) ** 2 - np.abs(crosses) ** 2) / np.abs(mapped) ** 2
    return by_pose
