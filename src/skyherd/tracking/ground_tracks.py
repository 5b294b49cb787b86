"""Ground positions of the robots in each image of one recording, and their distance from a shape.

The marker side is the unit of length unless its size in metres is given. The ground is known up to a
similarity, which the image fixes: x along +u, y against +v, and the image's centre as the origin. A moving
camera therefore moves all tracks. It does not affect the shape error. For figures,
`GroundTracks.steady_paths` removes its motion.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from skyherd.analysis.ground import shape_residual
from skyherd.control import Rectifier, Template
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex, to_points
from skyherd.messages import Detections
from skyherd.poses import ground_covariances, ground_positions

MOVE_STEPS, MIN_MOVE = 20, 1e-4
"""Steps of the search for a camera's motion, and the least distance in its weights, marker sides. Chosen: far
below the noise of a detection."""


@dataclass(frozen=True)
class Sighting:
    """Markers in one image, as detected and on the ground.

    Attributes:
        index: number of the image, from 0.
        time_s: time of the image.
        seen: the detections.
        positions: (N, 2) x and y on the ground, in the unit of the tracks.
        covariances: (N, 2, 2) their covariances; all zero without covariances of the detector.
        headings_rad: (N,) headings, counter-clockwise from +x.
    """

    index: int
    time_s: float
    seen: Detections
    positions: Array
    covariances: Array
    headings_rad: Array


@dataclass
class GroundTracks:
    """Tracks of one recording.

    Attributes:
        name: name of the recording.
        members: the robots; None for all markers. Other markers only help to rectify the ground.
        side_m: side of the markers, m; positions are then in metres. None for marker sides as the unit.
        sightings: one for each image, in order.
        strangers: detected markers that are not members.
    """

    name: str
    members: frozenset[int] | None = None
    side_m: float | None = None
    sightings: list[Sighting] = field(default_factory=list)
    strangers: set[int] = field(default_factory=set)
    _rectifier: Rectifier = field(default_factory=Rectifier)

    def add(self, index: int, found: Detections) -> None:
        """Add the markers of the next image, without ids that occur twice in it."""
        seen = found.unambiguous()
        flat = self._rectifier.rectify(seen)
        if self.members is not None:
            self.strangers |= set(found.ids.tolist()) - self.members
            seen, flat = seen.select(self.members), flat.select(self.members)
        side = self.side_m or 1.0
        positions, covariances = ground_positions(flat, side), ground_covariances(flat, side)
        headings_rad = -flat.headings_rad
        self.sightings.append(Sighting(index, found.time_s, seen, positions, covariances, headings_rad))

    @property
    def unit(self) -> str:
        """Unit of the positions, as an axis shows it."""
        return "marker sides" if self.side_m is None else "m"

    @property
    def ids(self) -> IntArray:
        """All detected markers, ascending."""
        ids = [sighting.seen.ids for sighting in self.sightings]
        return np.unique(np.concatenate(ids)) if ids else np.zeros(0, dtype=np.int64)

    def path(self, marker: int) -> tuple[Array, Array]:
        """Return the times (T,) of all images, and a marker's positions (T, 2), NaN without a detection."""
        times_s = np.array([sighting.time_s for sighting in self.sightings])
        positions = np.full((times_s.size, 2), np.nan)
        for row, sighting in enumerate(self.sightings):
            positions[row] = _where(sighting, marker)
        return times_s, positions

    def steady_paths(self) -> dict[int, tuple[Array, Array]]:
        """Return `path` of each marker in the frame of the first image, without the camera's motion."""
        turns, shifts = self._steady_moves().T
        steady = {}
        for marker in self.ids.tolist():
            times_s, positions = self.path(marker)
            steady[marker] = times_s, to_points(turns * to_complex(positions) + shifts)
        return steady

    def _steady_moves(self) -> ComplexArray:
        """Return rotations `e^{iφ}` and shifts (T, 2) from each image's positions to the first image's frame.

        Each image is moved onto the last known places of its markers, by the rotation and shift with the
        least sum of distances. Markers at rest determine it, as long as they are the majority; else it is the
        motion common to most markers.
        """
        known: dict[int, complex] = {}
        moves, turn, shift = [], 1.0 + 0.0j, 0.0 + 0.0j
        for sighting in self.sightings:
            ids, places = sighting.seen.ids.tolist(), to_complex(sighting.positions)
            common = [row for row, marker in enumerate(ids) if marker in known]
            if len(common) > 1:
                before = np.array([known[ids[row]] for row in common])
                turn, shift = _least_move(places[common], before, MIN_MOVE * (self.side_m or 1.0))
            moves.append((turn, shift))
            known |= zip(ids, (turn * places + shift).tolist(), strict=True)
        return np.array(moves, dtype=np.complex128).reshape(-1, 2)


def _least_move(places: ComplexArray, before: ComplexArray, min_move: float) -> tuple[complex, complex]:
    """Return the rotation and the shift of places (N,) with the least sum of distances from places (N,).

    Distances below `min_move` weigh as if they were that long.

    The least sum is found by least squares with weights 1/distance, repeated (Weiszfeld's algorithm).
    """
    weights = np.ones(places.size)
    for _ in range(MOVE_STEPS):
        source, target = np.average(places, weights=weights), np.average(before, weights=weights)
        along = np.vdot(places - source, weights * (before - target))
        turn = complex(along / abs(along)) if abs(along) else 1.0 + 0.0j
        shift = complex(target - turn * source)
        weights = 1 / np.maximum(np.abs(turn * places + shift - before), min_move)
    return turn, shift


def _where(sighting: Sighting, marker: int) -> Array:
    found = np.flatnonzero(sighting.seen.ids == marker)
    return sighting.positions[found[0]] if found.size else np.full(2, np.nan)


@dataclass(frozen=True)
class ShapeErrors:
    """Distances of the robots of a recording from a shape.

    Attributes:
        times_s: (T,) times of the images.
        errors: (T,) RMS distance to the best-fitting similarity of the shape over the RMS radius of the
            detected robots; NaN for fewer than three.
        counts: (T,) number of robots of the shape in each image.
        team: number of robots of the shape.
    """

    times_s: Array
    errors: Array
    counts: IntArray
    team: int


def shape_errors(tracks: GroundTracks, template: Template) -> ShapeErrors:
    """Compute the shape error of each image, from the robots of the template in it."""
    rows = list(_errors(tracks, template))
    times, errors, counts = zip(*rows, strict=True) if rows else ((), (), ())
    return ShapeErrors(np.array(times), np.array(errors), np.array(counts, dtype=np.int64), template.ids.size)


def _errors(tracks: GroundTracks, template: Template) -> Iterator[tuple[float, float, int]]:
    for sighting in tracks.sightings:
        points = to_complex(sighting.positions).conj()
        yield sighting.time_s, *shape_residual(template, sighting.seen.ids, points)
