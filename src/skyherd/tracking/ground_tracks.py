"""Where the robots of one recording were on the ground, image by image, and how far they were from a shape.

A marker's side is the unit of length, since its true size need not be known. The ground is known up to a
similarity, which is fixed by the image: x along +u, y against +v, and the image's centre as the origin. A
camera that moves therefore moves all tracks; the shape error is not affected.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from skyherd.analysis.ground import positions_in_sides, shape_residual
from skyherd.control import Rectifier, Template
from skyherd.geometry import Array, IntArray, to_complex
from skyherd.messages import Detections


@dataclass(frozen=True)
class Sighting:
    """One image: the markers as detected, and where they were on the ground.

    Attributes:
        index: of the image, from 0.
        time_s: of the image.
        seen: the markers as they were detected.
        positions_sides: (N, 2) x and y on the ground, in marker sides.
        headings_rad: (N,) counter-clockwise from +x.
    """

    index: int
    time_s: float
    seen: Detections
    positions_sides: Array
    headings_rad: Array


@dataclass
class GroundTracks:
    """The tracks of one recording.

    Attributes:
        name: of the recording.
        members: the robots; other markers help to rectify the ground, and are left out. None for all.
        sightings: one for each image, in order.
        strangers: markers that were seen and are none of the members.
    """

    name: str
    members: frozenset[int] | None = None
    sightings: list[Sighting] = field(default_factory=list)
    strangers: set[int] = field(default_factory=set)
    _rectifier: Rectifier = field(default_factory=Rectifier)

    def add(self, index: int, found: Detections) -> None:
        """Add the markers found in the next image; ids that occur twice in it are left out."""
        seen = found.unambiguous()
        flat = self._rectifier.rectify(seen)
        if self.members is not None:
            self.strangers |= set(found.ids.tolist()) - self.members
            seen, flat = seen.select(self.members), flat.select(self.members)
        positions = positions_in_sides(flat)
        self.sightings.append(Sighting(index, found.time_s, seen, positions, -flat.headings_rad))

    @property
    def ids(self) -> IntArray:
        """All markers that were ever seen, ascending."""
        ids = [sighting.seen.ids for sighting in self.sightings]
        return np.unique(np.concatenate(ids)) if ids else np.zeros(0, dtype=np.int64)

    def path(self, marker: int) -> tuple[Array, Array]:
        """Times (T,) of all images, and the marker's positions (T, 2), NaN where it was not seen."""
        times_s = np.array([sighting.time_s for sighting in self.sightings])
        positions = np.full((times_s.size, 2), np.nan)
        for row, sighting in enumerate(self.sightings):
            positions[row] = _where(sighting, marker)
        return times_s, positions


def _where(sighting: Sighting, marker: int) -> Array:
    found = np.flatnonzero(sighting.seen.ids == marker)
    return sighting.positions_sides[found[0]] if found.size else np.full(2, np.nan)


@dataclass(frozen=True)
class ShapeErrors:
    """How far the robots of a recording were from a shape.

    Attributes:
        times_s: (T,) of the images.
        errors: (T,) RMS distance to the best-fitting similarity of the shape over the RMS radius of the
            robots seen; NaN where fewer than three were.
        counts: (T,) robots of the shape that the image shows.
        team: number of robots of the shape.
    """

    times_s: Array
    errors: Array
    counts: IntArray
    team: int


def shape_errors(tracks: GroundTracks, template: Template) -> ShapeErrors:
    """The shape error of each image, of those robots of the template that it shows."""
    rows = list(_errors(tracks, template))
    times, errors, counts = zip(*rows, strict=True) if rows else ((), (), ())
    return ShapeErrors(np.array(times), np.array(errors), np.array(counts, dtype=np.int64), template.ids.size)


def _errors(tracks: GroundTracks, template: Template) -> Iterator[tuple[float, float, int]]:
    for sighting in tracks.sightings:
        points = to_complex(sighting.positions_sides).conj()
        yield sighting.time_s, *shape_residual(template, sighting.seen.ids, points)
