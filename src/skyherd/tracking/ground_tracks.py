"""Ground positions of the robots in each image of one recording, and their distance from a shape.

The median marker's side is the unit of length unless its size in metres is given. The ground is known up to a
similarity, which the image fixes: x along +u, y against +v, and the image's centre as the origin. A moving
camera therefore moves all tracks. It does not affect the shape error.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from skyherd.analysis.ground import shape_residual
from skyherd.control import Rectifier, Template
from skyherd.geometry import Array, IntArray, to_complex
from skyherd.messages import Detections
from skyherd.poses import ground_covariances, ground_positions, recording_scales


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
        strangers: detected markers that are not members.
    """

    name: str
    members: frozenset[int] | None = None
    side_m: float | None = None
    strangers: set[int] = field(default_factory=set)
    _images: list[tuple[int, Detections, Detections]] = field(default_factory=list)
    _rectifier: Rectifier = field(default_factory=Rectifier)

    def add(self, index: int, found: Detections) -> None:
        """Add the markers of the next image, without ids that occur twice in it."""
        seen = found.unambiguous()
        flat = self._rectifier.rectify(seen)
        if self.members is not None:
            self.strangers |= set(found.ids.tolist()) - self.members
            seen, flat = seen.select(self.members), flat.select(self.members)
        self._images.append((index, seen, flat))
        self.__dict__.pop("sightings", None)

    @cached_property
    def sightings(self) -> list[Sighting]:
        """The markers of each image on the ground, in order."""
        side, scales = self.side_m or 1.0, recording_scales([flat for _, _, flat in self._images])
        sightings = []
        for (index, seen, flat), scale in zip(self._images, scales.tolist(), strict=True):
            positions, covariances = (of(flat, side, scale) for of in (ground_positions, ground_covariances))
            sightings.append(Sighting(index, seen.time_s, seen, positions, covariances, -flat.headings_rad))
        return sightings

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
