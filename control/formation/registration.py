"""Image registration: image points of the whole team, from a unit's own view and its neighbours' views.

Two downward-looking cameras see the ground plane through images that differ by a similarity. Two common
robots determine it. It maps all other points of the neighbour's view into the unit's own image, also beyond
its borders.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.formation.similarity import fit_similarity
from skyherd.errors import DegenerateSetError
from skyherd.geometry import BoolArray, ComplexArray, IntArray, to_complex
from skyherd.messages import Detections, UnitReport, rows_of

MIN_COMMON_ROBOTS = 2
"""Minimum number of common robots of two views. Derived: a similarity has four parameters, a point two."""


@dataclass(frozen=True)
class Registration:
    """Image points of the team in one unit's image.

    Attributes:
        points_px: (N,) points as `u + iv`, robots in the order of the team's ids.
        known: (N,) mask of the robots with known points; the other points are undefined.
    """

    points_px: ComplexArray
    known: BoolArray


def register_views(team_ids: IntArray, seen: Detections, reports: Sequence[UnitReport]) -> Registration:
    """Return points of the team in a unit's image, from its own view and the views of other units.

    Each reported view is mapped by the similarity that fits the robots with known points. The view with the
    most such robots is next, so that a chain of overlapping views is followed to its end. Views with fewer
    than two such robots, or with coincident ones, are ignored. A report is some frames older than the image.
    The error from the robots' motion in between is accepted.

    Args:
        team_ids: (N,) robots of the team, ascending.
        seen: detections of robots of the team in the unit's own image.
        reports: the newest reports of other units.
    """
    points = np.zeros(team_ids.size, dtype=np.complex128)
    known = np.zeros(team_ids.size, dtype=bool)
    rows = rows_of(team_ids, seen.ids)
    points[rows], known[rows] = to_complex(seen.centers_px), True
    views = [(rows_of(team_ids, report.ids), to_complex(report.points_px)) for report in reports]
    while views:
        common = [int(known[rows].sum()) for rows, _ in views]
        best = int(np.argmax(common))
        if common[best] < MIN_COMMON_ROBOTS:
            break
        rows, theirs = views.pop(best)
        shared = known[rows]
        try:
            similarity = fit_similarity(theirs[shared], points[rows[shared]])
        except DegenerateSetError:
            continue
        points[rows[~shared]], known[rows[~shared]] = similarity(theirs[~shared]), True
    return Registration(points, known)
