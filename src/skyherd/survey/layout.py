"""Layout of several markers on one robot, as keys of scenario and lab files, from a survey of the robot."""

import numpy as np

from skyherd.errors import InputError
from skyherd.markers.layout import FACES, Face, Place
from skyherd.survey.measure import MarkerPose, Survey

MAX_TILT_DEG = 15.0
"""Maximum angle between a marker's normal and that of a face, deg. Chosen: above the errors of a hand-made
robot, far below half of the 90 degrees between two faces."""


ROUNDING_SIDES = 1e-4
"""Unit of the written lengths, marker sides. Chosen: a tenth of the smallest errors."""

FLAT_SIDES = 0.05
"""Range of heights up to which markers on top count as one plane, marker sides. Chosen: sheets on one board;
a flat layout needs no camera model."""


def layout_text(found: Survey) -> str:
    """Return the TOML value of `robots.markers` or `markers.on_robots` for the robot that was surveyed.

    The robot's marker is the reference of the survey, and the robot's reference point lies below its centre:
    at the height of the lowest edge of all markers, or of the markers if all lie on top in one plane.
    Comments state the standard deviations.

    Raises:
        InputError: a marker has a lower id than the reference, or lies on no face of a box.
    """
    of_robot = [marker for marker in found.markers if marker.view is None]
    of_robot.sort(key=lambda one: (one.id != found.reference, one.id))
    places = [_place(marker, found) for marker in of_robot]
    heights = [place.height_sides for place in places]
    is_flat = all(place.face == "top" for place in places) and max(heights) - min(heights) < FLAT_SIDES
    # Rounded up, so that no edge of the written layout is below the reference point.
    base_sides = np.ceil(-min(place.lowest_sides for place in places) / ROUNDING_SIDES) * ROUNDING_SIDES
    lines = []
    for marker, place in zip(of_robot, places, strict=True):
        keys = [
            f"add_to_id = {place.add_to_id}",
            *([] if place.face == "top" else [f'face = "{place.face}"']),
            "offset_sides = [{:.4f}, {:.4f}]".format(*place.offset_sides),
            *([] if is_flat else [f"height_sides = {place.height_sides + base_sides:.4f}"]),
            f"yaw_deg = {np.degrees(place.yaw_rad):.2f}",
        ]
        std = np.sqrt(np.diag(marker.covariance))
        error = f"std {std[:3].max() / found.side_m:.1g} sides, {np.degrees(std[3:].max()):.1g} deg"
        lines.append(f"  {{ {', '.join(keys)} }}, # {error}")
    return "\n".join(["markers = [", *lines, "]"])


def _place(marker: MarkerPose, found: Survey) -> Place:
    """Return the place of a marker on the robot, rounded, with its height above the reference marker."""
    if marker.id < found.reference:
        what = f"{found.reference} is the reference, above marker {marker.id}"
        raise InputError("reference", what, "the lowest id of the robot")
    face, yaw_deg = _face(marker)
    x, y, z = (np.round(marker.position_m / found.side_m / ROUNDING_SIDES) * ROUNDING_SIDES).tolist()
    return Place(marker.id - found.reference, (x + 0.0, y + 0.0), float(np.radians(yaw_deg)), z, face)


def _face(marker: MarkerPose) -> tuple[Face, float]:
    """Return the face whose normal is that of a marker, and the direction of the marker on it, deg."""
    normals = {name: np.cross(*np.array(axes, dtype=float)) for name, axes in FACES.items()}
    name = max(normals, key=lambda one: float(normals[one] @ marker.rotation[:, 2]))
    tilt_deg = float(np.degrees(np.arccos(np.clip(normals[name] @ marker.rotation[:, 2], -1, 1))))
    if tilt_deg > MAX_TILT_DEG:
        what = f"is tilted by {tilt_deg:.0f} deg against the face {name!r}"
        raise InputError(f"marker {marker.id}", what, f"at most {MAX_TILT_DEG:g} deg, on a face of a box")
    forward, left = (np.array(axis, dtype=float) for axis in FACES[name])
    return name, _degrees(marker.rotation[:, 0] @ forward, marker.rotation[:, 0] @ left)


def _degrees(along: float, across: float) -> float:
    """Return the angle of a direction, deg, as written: with two decimals and no negative zero."""
    return float(np.round(np.degrees(np.arctan2(across, along)), 2)) + 0.0
