"""Sightings of a live unit, with markers at the image's origin where their places do not matter."""

from collections.abc import Sequence

import numpy as np

from skyherd.messages import Sighting


def make_sighting(
    time_s: float,
    ids: Sequence[int],
    repeated_ids: Sequence[int] = (),
    unit: int = 0,
    *,
    center_px: complex = 0.0,
    heading_rad: float = 0.0,
) -> Sighting:
    """Return the sighting of an image with markers of 20 px, all with the same centre and heading."""
    n, place = len(ids), [np.real(center_px), np.imag(center_px)]
    centers_px, headings_rad = np.tile(place, (n, 1)), np.full(n, heading_rad)
    return Sighting(unit, time_s, ids, repeated_ids, centers_px, headings_rad, np.full(n, 20.0))
