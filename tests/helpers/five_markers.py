"""Scenarios of robots with five markers each, on top or on the faces of a cube, under tilted cameras."""

import math
from typing import Any

MARKERS: list[dict[str, Any]] = [
    {},
    {"add_to_id": 10, "offset_sides": [1.5, 1.5]},
    {"add_to_id": 20, "offset_sides": [1.5, -1.5], "yaw_deg": 90},
    {"add_to_id": 30, "offset_sides": [-1.5, 1.5], "yaw_deg": 20},
    {"add_to_id": 40, "offset_sides": [-1.5, -1.5]},
]
"""Markers on each robot."""

CUBE: list[dict[str, Any]] = [
    {"height_sides": 1.5},
    {"add_to_id": 10, "face": "front", "offset_sides": [0.75, 0.0], "height_sides": 0.75},
    {"add_to_id": 20, "face": "left", "offset_sides": [0.0, 0.75], "height_sides": 0.75},
    {"add_to_id": 30, "face": "back", "offset_sides": [-0.75, 0.0], "height_sides": 0.75, "yaw_deg": 90},
    {"add_to_id": 40, "face": "right", "offset_sides": [0.0, -0.75], "height_sides": 0.75},
]
"""Markers on a cube with a side of 1.5 marker sides that stands on the ground."""


def five_markers() -> dict[str, Any]:
    """Return a scenario of six robots as a tree of plain values."""
    camera = {"half_angle_deg": 34.0, "size_px": [800, 800]}
    return {
        "name": "five",
        "seed": 4,
        "duration_s": 4.0,
        "template": {"points": [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0.5], [-1, 0.5]]},
        "robots": {
            "scatter": {"scale_m": 1.6, "jitter_m": 0.4, "spacing_m": 1.3},
            "markers": [dict(place) for place in MARKERS],
        },
        "marker": {"side_m": 0.25},
        "control": {"k": 0.3, "k_omega": 1.2},
        "units": [
            {
                "position_m": [0.5, -2.5],
                "height_m": 7.0,
                "tilt_deg": [-20.0, 5.0],
                "camera": camera,
                "flight": {"kind": "hover"},
            },
            {
                "position_m": [-2.0, 1.0],
                "height_m": 7.0,
                "yaw_deg": 90,
                "tilt_deg": [-15.0, 0.0],
                "camera": camera,
                "flight": {"kind": "hover"},
            },
        ],
    }


def cubes() -> dict[str, Any]:
    """Return the same with cubes, between three cameras that look at them from all sides at 40°."""
    tree = five_markers()
    tree["robots"]["markers"] = [dict(place) for place in CUBE]
    tree["units"] = [
        {
            "position_m": [4.2 * math.sin(yaw), -4.2 * math.cos(yaw)],
            "height_m": 5.0,
            "yaw_deg": math.degrees(yaw),
            "tilt_deg": [-40.0, 0.0],
            "camera": {"half_angle_deg": 30.0, "size_px": [800, 800]},
            "flight": {"kind": "hover"},
        }
        for yaw in (0.3, 0.3 + 2 * math.pi / 3, 0.3 - 2 * math.pi / 3)
    ]
    return tree
