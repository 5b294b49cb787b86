"""Confirmation of markers on a photograph: two independent detectors agree on place and id.

Sightings of one id whose centres are within `SAME_PLACE_SIDES` of a side are one place. A place is confirmed
if detectors of two families find it. Skyherd's own detectors are one family. All refinements of `cv2.aruco`
are another, since these search and read alike. Each other detector is a family of its own. Conflicts are two
confirmed ids at one place, and two places of an id in a set without repeated ids. The one with more families
then counts.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from skyherd.bench.entrants import is_ours
from skyherd.bench.photographs.sightings import Sightings
from skyherd.geometry import Array
from skyherd.markers.dictionary import pose_of_corners
from skyherd.messages import Quality

SAME_PLACE_SIDES = 0.3
"""Maximum distance of centres at one place, in sides of the smaller square. Chosen: centres of separate
markers are at least a side apart; a corner off by a side moves a centre by a quarter."""

ENOUGH_FAMILIES = 2
"""Number of families that confirm a marker. Chosen: with three, markers that only the best two detectors
find would never count."""


@dataclass(frozen=True)
class Place:
    """A place in an image where one id was found.

    Attributes:
        marker_id: the id.
        center_px: (2,) median of the centres found.
        side_px: median of the sides found.
        corners_px: (4, 2) from the first detector.
        found_by: names of the detectors, in their order.
        fitted_by: names of those that measured it by a photometric fit.
    """

    marker_id: int
    center_px: Array
    side_px: float
    corners_px: Array
    found_by: tuple[str, ...]
    fitted_by: tuple[str, ...] = ()

    @property
    def families(self) -> int:
        """Number of independent detectors that found it."""
        return len({family(name) for name in self.found_by})


@dataclass(frozen=True)
class Judged:
    """Classified places of one image.

    Attributes:
        confirmed: places of markers.
        mistaken: places where a confirmed marker was read as another id.
        alone: places that only one family of detectors found.
    """

    confirmed: tuple[Place, ...]
    mistaken: tuple[Place, ...]
    alone: tuple[Place, ...]


def family(name: str) -> str:
    """Return the family of a detector: `ours`, `opencv`, or its own name."""
    if is_ours(name):
        return "ours"
    return "opencv" if name.startswith("opencv") else name


def judge(found: Mapping[str, Sightings], *, ids_repeat: bool = False) -> Judged:
    """Classify the places in an image, from the sightings of all detectors.

    Args:
        found: sightings by the detector's name.
        ids_repeat: allow confirmation of an id at several places.
    """
    ranked = sorted(_places(found), key=lambda place: (-place.families, place.marker_id))
    confirmed: list[Place] = []
    others: list[Place] = []
    for place in ranked:
        rival = any(
            same_place(place, known) or (not ids_repeat and place.marker_id == known.marker_id)
            for known in confirmed
        )
        (others if rival or place.families < ENOUGH_FAMILIES else confirmed).append(place)
    mistaken = [place for place in others if any(same_place(place, known) for known in confirmed)]
    alone = [place for place in others if not any(same_place(place, known) for known in confirmed)]
    return Judged(tuple(confirmed), tuple(mistaken), tuple(alone))


def same_place(one: Place, other: Place) -> bool:
    """Return whether two places are one, whatever the ids."""
    apart = float(np.hypot(*(one.center_px - other.center_px)))
    return apart < SAME_PLACE_SIDES * min(one.side_px, other.side_px)


def _places(found: Mapping[str, Sightings]) -> list[Place]:
    names = [name for name, seen in found.items() for _ in seen.ids]
    if not names:
        return []
    ids = np.concatenate([seen.ids for seen in found.values()])
    corners = np.concatenate([seen.corners_px for seen in found.values()])
    fitted = np.concatenate([seen.qualities == Quality.PHOTOMETRIC for seen in found.values()])
    centers, _, sides = pose_of_corners(corners)
    apart = np.linalg.norm(centers[:, None] - centers, axis=2)
    near = (apart < SAME_PLACE_SIDES * np.minimum(sides[:, None], sides)) & (ids[:, None] == ids)
    count, group = connected_components(csr_array(near), directed=False)
    members = [np.flatnonzero(group == number) for number in range(count)]
    return [
        Place(
            marker_id=int(ids[who[0]]),
            center_px=np.median(centers[who], axis=0),
            side_px=float(np.median(sides[who])),
            corners_px=corners[who[0]],
            found_by=tuple(dict.fromkeys(names[k] for k in who)),
            fitted_by=tuple(dict.fromkeys(names[k] for k in who if fitted[k])),
        )
        for who in members
    ]
