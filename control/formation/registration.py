"""Where the whole team lies in one unit's image: its own view, and those of others laid beside it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.control.formation.similarity import fit_similarity
from skyherd.errors import DegenerateSetError
from skyherd.geometry import BoolArray, ComplexArray, IntArray, to_complex
from skyherd.messages import Detections, UnitReport

ANCHORS = 2
"""Robots in common that tell the similarity between two images."""


@dataclass(frozen=True)
class Registration:
    """Image points (N,) of the team as `u + iv`, in the order of its ids; known (N,) tells whose they are."""

    points_px: ComplexArray
    known: BoolArray


def register_views(team_ids: IntArray, seen: Detections, reports: Sequence[UnitReport]) -> Registration:
    """Lay the views of others beside one's own, each by the similarity that robots in common tell.

    The view with the most robots in common with what is known so far comes next, so that a chain of
    neighbours reaches to its end. Reports are some frames old; robots move a little meanwhile.

    Args:
        team_ids: (N,) ascending.
        seen: robots of the team in the own image.
        reports: what other units see.
    """
    points = np.zeros(team_ids.size, dtype=np.complex128)
    known = np.zeros(team_ids.size, dtype=bool)
    rows = np.searchsorted(team_ids, seen.ids)
    points[rows], known[rows] = to_complex(seen.centers_px), True
    views = [(np.searchsorted(team_ids, report.ids), to_complex(report.points_px)) for report in reports]
    while views:
        common = [int(known[rows].sum()) for rows, _ in views]
        best = int(np.argmax(common))
        if common[best] < ANCHORS:
            break
        rows, theirs = views.pop(best)
        shared = known[rows]
        try:
            similarity = fit_similarity(theirs[shared], points[rows[shared]])
        except DegenerateSetError:
            continue
        points[rows[~shared]], known[rows[~shared]] = similarity(theirs[~shared]), True
    return Registration(points, known)
