"""Tracks of robots in overhead recordings, on the ground in marker sides, and the shape that they form.

Start with `track_videos`.
"""

from skyherd.tracking.ground_tracks import GroundTracks, ShapeErrors, shape_errors
from skyherd.tracking.shapes import ShapeSource, named_shape, scenario_shape
from skyherd.tracking.tracker import FIGURE, POSES, SHAPE, TRACKS, track_videos

__all__ = [
    "FIGURE",
    "POSES",
    "SHAPE",
    "TRACKS",
    "GroundTracks",
    "ShapeErrors",
    "ShapeSource",
    "named_shape",
    "scenario_shape",
    "shape_errors",
    "track_videos",
]
