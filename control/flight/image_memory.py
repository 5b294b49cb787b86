"""Memory of image points: positions of robots in a unit's image, including robots outside the view."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.similarity import Similarity, fit_similarities, fit_similarity
from skyherd.control.formation.template import Template
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, BoolArray, ComplexArray, IntArray, to_complex, to_points
from skyherd.messages import Detections, UnitReport, centred
from skyherd.messages.ids import find_rows


@dataclass
class ImageMemory:
    """Last known image points of the team in one unit's image, updated as the unit moves.

    Two robots that two units see determine the similarity between their images. It gives the positions in
    this unit's image of all robots that the other unit sees, inside the frame or not. Two robots located in
    this way do the same for a unit without common robots. Robots that no unit sees now are moved by the
    similarity between this unit's last and present image, fitted to the robots in both.

    Attributes:
        template: template with the ids of the team.
        points_px: (N,) as `u + iv`, in the order of the template's ids.
        known: (N,) mask of the robots with a known position.
        seen_s: (N,) time at which the unit itself last saw each robot; -inf if never.
        centers_px: image centres of the other units in the own image, by unit.
    """

    template: Template
    points_px: ComplexArray = field(init=False)
    known: BoolArray = field(init=False)
    seen_s: Array = field(init=False)
    centers_px: dict[int, complex] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        count = self.template.ids.size
        self.points_px = np.zeros(count, dtype=np.complex128)
        self.known = np.zeros(count, dtype=bool)
        self.seen_s = np.full(count, -np.inf)

    def update(self, seen: Detections, reports: Sequence[UnitReport]) -> None:
        """Update the memory with an image and the last report of each other unit."""
        rows, points = self.rows(seen.ids), to_complex(seen.centers_px)
        moved = _fit(self.points_px[rows], points, self.known[rows] & (self.seen_s[rows] > -np.inf))
        if moved is not None:
            self.points_px[self.known] = moved(self.points_px[self.known])
        self.points_px[rows], self.known[rows], self.seen_s[rows] = points, True, seen.time_s
        in_view = np.zeros(self.known.size, dtype=bool)
        in_view[rows] = True
        self.centers_px.clear()
        while reports:
            placed, reports = self._place_reported(reports, in_view)
            if not (placed and reports):
                break
            rows, known = find_rows(self.template.ids, np.concatenate([report.ids for report in placed]))
            in_view[rows[known]] = True

    def _place_reported(
        self, reports: Sequence[UnitReport], in_view: BoolArray
    ) -> tuple[list[UnitReport], list[UnitReport]]:
        """Compute positions of robots that only other units see; the last report of a robot is used.

        Ids that are not in the template are ignored.

        Args:
            reports: reports of other units.
            in_view: (N,) mask of the robots with a known position in this unit's present image.

        Returns:
            The reports that were used, and the reports with fewer than two robots in common with the known
            ones.
        """
        sender = np.repeat(np.arange(len(reports)), [report.ids.size for report in reports])
        rows, known = find_rows(self.template.ids, np.concatenate([report.ids for report in reports]))
        points = to_complex(np.concatenate([report.points_px for report in reports]))
        sender, rows, points = sender[known], rows[known], points[known]
        common = in_view[rows]
        images = fit_similarities(
            points[common], self.points_px[rows[common]], group=sender[common], groups=len(reports)
        )
        hidden = ~common & images.exist[sender]
        self.points_px[rows[hidden]] = images(points[hidden], sender[hidden])
        self.known[rows[hidden]] = True
        fitted = np.flatnonzero(images.exist).tolist()
        middles = to_complex(np.reshape([(reports[row].image_size_px - 1) / 2 for row in fitted], (-1, 2)))
        units = (reports[row].unit_id for row in fitted)
        self.centers_px.update(
            zip(units, images(middles, np.array(fitted, dtype=np.int64)).tolist(), strict=True)
        )
        return (
            [report for report, exists in zip(reports, images.exist, strict=True) if exists],
            [report for report, exists in zip(reports, images.exist, strict=True) if not exists],
        )

    def rows(self, ids: IntArray) -> IntArray:
        """Return the rows of robots of the team."""
        return np.asarray(self.template.ids.searchsorted(ids), dtype=np.int64)

    def centred(self, ids: IntArray, image_size_px: Array) -> Array:
        """Return points (M, 2), from the image centre in half images, of the robots with a known position."""
        rows = self.rows(ids)
        return centred(to_points(self.points_px[rows[self.known[rows]]]), image_size_px)


def _fit(source: ComplexArray, target: ComplexArray, use: BoolArray) -> Similarity | None:
    """Return the similarity from the points in `use` (N,) to their counterparts, or None if undefined."""
    if np.count_nonzero(use) < 2:
        return None
    try:
        return fit_similarity(source[use], target[use])
    except DegenerateSetError:
        return None
