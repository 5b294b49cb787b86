"""Where markers will be in the next image, extrapolated from the last two.

Two kinds of motion are told apart. A robot on an arc, or a camera that turns or zooms, moves a marker's
centre by steps that turn and grow as the marker's similarity does; a camera that flies past moves it by equal
steps. Each marker's next step is taken to be of the kind that its last step was nearer to.

When the camera's velocity changes, all markers lie elsewhere, the more so the farther from the image's centre
they are. But they moved alike: a camera's motion over flat ground takes every point p of the image to about
`a p + b`. A few markers determine that similarity, and the others are then fitted where it takes them.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from skyherd.geometry import SQUARE_CORNERS, Array, BoolArray, ComplexArray, IntArray
from skyherd.vision.grey import Image
from skyherd.vision.native.follow_records import TRACK
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.surroundings import Surroundings
from skyherd.vision.row_record import RowRecord
from skyherd.vision.search.quads import find_quads

MAX_SHARE = 0.5
"""Share of an image up to which it is searched by parts. Chosen: parts overlap, and each costs something."""

NEAR_MARKERS = 4
"""Markers about whose places an image is searched when none is where it was predicted. Chosen: one tells the
motion, and some may be hidden or go ways of their own; each takes about a millisecond."""

REACH_SIDES = 3.0
"""How far from its predicted place a marker is searched for, in its sides. Chosen: a camera that starts to
climb at 1 m/s over 10 m moves markers in the corner of an image by half a side within 0.2 s, and those near
its middle less; the time grows with the square."""

MIN_MARKERS = 3
"""Markers that tell a rotation at least. Chosen: two robots side by side that drive apart look like one."""

MAX_MISSED = 10
"""Images for which a marker that is not found is predicted on and searched for. Chosen: the image is searched
whole twice meanwhile, so that nothing waits longer for a search than it would without."""

MAX_LOG_GROWTH = 7.0
"""Largest natural logarithm of a marker's predicted growth or shrinking. Chosen: a factor of 1000, beyond
which nothing can be followed. A camera that is resumed after hours predicts no infinite marker."""

MIN_SHIFT_SIDES = 0.02
"""Markers are fitted again only if the motion moves them by more than this, in their sides. Chosen: fits find
a marker that lies a tenth of a side off, so that one that was missed for less is missed for another
reason."""


@dataclass(frozen=True)
class Tracks(RowRecord):
    """The N markers being followed, each as it was last seen.

    Attributes:
        ids: (N,) marker ids, ascending.
        times_s: (N,) when each was last seen.
        homographies: of the markers when they were last seen.
        velocities: (N,) of the centres, px/s, complex; zero for a marker seen once.
        similarity_log_rates: (N,) rates of the similarities' logarithms, 1/s: real part growth, imaginary
            part rotation.
        on_arc: (N,) whether the centres' steps turn and grow with the similarities.
        sigmas_px: (N,) standard deviations of the blur, lens and pixel together, px.
        surroundings: of the markers.
        missed: (N,) images since then in which the marker was not found.
    """

    ids: IntArray
    times_s: Array
    homographies: LocalHomographies
    velocities: ComplexArray
    similarity_log_rates: ComplexArray
    on_arc: BoolArray
    sigmas_px: Array
    surroundings: Surroundings
    missed: IntArray

    @classmethod
    def of_records(cls, records: npt.NDArray[np.void]) -> "Tracks":
        """Return the tracks of records (N,) of `TRACK`, which are not copied."""
        fields = {name: records[name] for name in TRACK.names or ()}
        tracks = cls(
            homographies=LocalHomographies.of_records(fields.pop("homographies")),
            surroundings=Surroundings.of_records(fields.pop("surroundings")),
            on_arc=fields.pop("on_arc") != 0,
            **fields,
        )
        tracks.__dict__["records"] = records
        return tracks

    @cached_property
    def records(self) -> npt.NDArray[np.void]:
        """The tracks as records (N,) of `TRACK`."""
        records = np.empty(self.ids.size, dtype=TRACK)
        for name in TRACK.names or ():
            own = getattr(self, name)
            records[name] = own.records() if isinstance(own, LocalHomographies | Surroundings) else own
        return records

    @property
    def seen(self) -> "Tracks":
        """The tracks of markers that the last image showed."""
        return self.take(self.missed == 0)

    def predicted(self, time_s: float) -> LocalHomographies:
        """Return the homographies expected at `time_s`.

        Similarities go on turning and growing at their rates; so do the steps of centres `on_arc`, while the
        other centres go on straight. The anisotropies, which are fixed in image axes, turn with the
        similarities.
        """
        elapsed_s = self._elapsed_s(time_s)
        turn = self._turns(elapsed_s)
        return LocalHomographies(
            centers=self.homographies.centers + self.velocities * np.where(self.on_arc, turn, 1) * elapsed_s,
            similarities=self.homographies.similarities * turn,
            anisotropies=self.homographies.anisotropies * turn.conj(),
            perspectives=self.homographies.perspectives,
        )

    def updated(self, time_s: float, shown: "ShownMarkers") -> "Tracks":
        """Return the tracks after an image at `time_s` that shows markers (N,).

        Markers that were followed before get a velocity, unless they are farther from where they were
        predicted than they would be searched for: that is another place, or another camera. Markers that are
        not shown are kept for `MAX_MISSED` images. Ids ascend.
        """
        ids, homographies = shown.ids, shown.homographies
        now, before = np.nonzero(ids[:, None] == self.ids)
        velocities, rates = np.zeros((2, ids.size), dtype=complex)
        on_arc = np.ones(ids.size, dtype=bool)
        near = shifts_sides(self.predicted(time_s).take(before), homographies.take(now)) <= REACH_SIDES
        now, before = now[near], before[near]
        last, elapsed_s = self.take(before), self._elapsed_s(time_s)[before]
        velocities[now] = (homographies.centers[now] - last.homographies.centers) / elapsed_s
        rates[now] = np.log(homographies.similarities[now] / last.homographies.similarities) / elapsed_s
        turned = last.velocities * last._turns(elapsed_s)
        on_arc[now] = np.abs(velocities[now] - turned) <= np.abs(velocities[now] - last.velocities)
        times_s, missed = np.full(ids.size, time_s), np.zeros(ids.size, dtype=np.int64)
        motion = velocities, rates, on_arc
        seen = Tracks(ids, times_s, homographies, *motion, shown.sigmas_px, shown.surroundings, missed)
        missing = self.take(~np.isin(self.ids, ids) & (self.missed < MAX_MISSED))
        return seen._with(replace(missing, missed=missing.missed + 1))

    def with_others(self, time_s: float, shown: "ShownMarkers") -> "Tracks":
        """Return the tracks if the last image, at `time_s`, shows other markers (N,), too.

        They are taken to stand still. An id at two places is not followed any more. Ids ascend.
        """
        is_once = (shown.ids[:, None] == shown.ids).sum(axis=1) == 1
        others = no_tracks().updated(time_s, shown.take(is_once & ~np.isin(shown.ids, self.seen.ids)))
        return self.take(~np.isin(self.ids, shown.ids))._with(others)

    def _elapsed_s(self, time_s: float) -> Array:
        """Return the times (N,) since markers were seen; 1 s for each image if times do not increase."""
        return np.where(time_s > self.times_s, time_s - self.times_s, 1.0 + self.missed)

    def _turns(self, elapsed_s: Array) -> ComplexArray:
        """Return the factors (N,) by which similarities turn and grow within times (N,), s."""
        logs = self.similarity_log_rates * elapsed_s
        return np.exp(np.clip(logs.real, -MAX_LOG_GROWTH, MAX_LOG_GROWTH) + 1j * logs.imag)

    def _with(self, others: "Tracks") -> "Tracks":
        """Return these tracks and others, in ascending order of id."""
        both = self.joined(others)
        return both.take(np.argsort(both.ids, kind="stable"))


@dataclass(frozen=True)
class ShownMarkers(RowRecord):
    """Markers that an image shows.

    Attributes:
        ids: (N,) of the markers.
        homographies: of the markers.
        sigmas_px: (N,) standard deviations of the blur, lens and pixel together, px.
        surroundings: of the markers.
    """

    ids: IntArray
    homographies: LocalHomographies
    sigmas_px: Array
    surroundings: Surroundings


def no_tracks() -> Tracks:
    """Return tracks of no marker."""
    empty, numbers = np.zeros(0, dtype=complex), np.zeros(0, dtype=np.int64)
    places = LocalHomographies(empty, empty, empty, empty)
    times_s, sigmas_px, on_arc = np.zeros(0), np.zeros(0), numbers.astype(bool)
    cards = Surroundings.of_cards(0)
    return Tracks(numbers, times_s, places, empty, empty, on_arc, sigmas_px, cards, numbers)


def common_motion(before: LocalHomographies, after: LocalHomographies) -> tuple[complex, complex]:
    """Return the similarity (a, b), `p -> a p + b`, that takes markers (N,), at least one, to where they are.

    By least squares over their centres, which says nothing of how each robot turned by itself. Fewer than
    `MIN_MARKERS` tell no rotation, and the scale by their sides.
    """
    middle, target = before.centers.mean(), after.centers.mean()
    here, there = before.centers - middle, after.centers - target
    if here.size < MIN_MARKERS:
        a = complex(np.median(after.sides_px() / before.sides_px()))
    else:
        a = complex(np.vdot(here, there) / np.vdot(here, here).real)
    return a, complex(target - a * middle)


def apply_similarity(markers: LocalHomographies, motion: tuple[complex, complex]) -> LocalHomographies:
    """Return where a similarity (a, b) of the image takes markers.

    Relative anisotropies `k / m̄` and perspectives stay: the camera's tilt makes them, in the image's axes.
    """
    a, b = motion
    return replace(
        markers,
        centers=a * markers.centers + b,
        similarities=a * markers.similarities,
        anisotropies=np.conj(a) * markers.anisotropies,
    )


def shifts_sides(before: LocalHomographies, after: LocalHomographies) -> Array:
    """Return by how much (N,) markers' corners moved at most, in their sides."""
    moved_px = np.abs(after.images(SQUARE_CORNERS) - before.images(SQUARE_CORNERS)).max(axis=1)
    return np.asarray(moved_px / before.sides_px())


def find_quads_near(image: Image, markers: LocalHomographies, missed: IntArray) -> Array:
    """Return the corners (Q, 4, 2), px, of quadrilaterals near the places of N markers, in any order.

    The reach grows with the number of images (N,) in which a marker was missed. If the places are most of the
    image, they are those of the whole image.
    """
    boxes = []
    reaches_px = REACH_SIDES * (1 + missed) * markers.sides_px()
    for center, reach_px in zip(markers.centers.tolist(), reaches_px.tolist(), strict=True):
        columns, lines = (
            slice(max(0, math.floor(at - reach_px)), max(0, math.ceil(at + reach_px) + 1))
            for at in (center.real, center.imag)
        )
        boxes.append((image[lines, columns], (columns.start, lines.start)))
    if sum(box.size for box, _ in boxes) > MAX_SHARE * image.size:
        return find_quads(image)
    return np.concatenate([np.zeros((0, 4, 2)), *(find_quads(box) + corner for box, corner in boxes)])


def innermost(markers: LocalHomographies, image: Image) -> LocalHomographies:
    """Return the `NEAR_MARKERS` of N markers that are nearest to the image's middle.

    They move least when the camera climbs, turns or zooms.
    """
    height, width = image.shape
    order = np.argsort(np.abs(markers.centers - complex(width - 1, height - 1) / 2))
    return markers.take(order[:NEAR_MARKERS])
