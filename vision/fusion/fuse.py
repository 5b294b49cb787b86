"""Fusion of several markers on a robot into one detection of the robot.

A robot is detected if one of its markers is. Markers that do not agree on the robot's place are separate
detections of the robot, so that its id is repeated and counts as ambiguous.

Markers in one plane parallel to the ground need no camera model (`planar`). Markers on several faces need a
pinhole camera, whose focal length is estimated from the image (`spatial`).
"""

from skyherd.errors import InputError
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import Detections
from skyherd.messages.checks import check_kind
from skyherd.vision.fusion.planar import fuse_planar_markers
from skyherd.vision.fusion.spatial import fuse_spatial_markers
from skyherd.vision.grey import Image
from skyherd.vision.photometric.remeasure import measure_outlines


def fuse_markers(
    found: Detections,
    layout: MarkerLayout,
    image: Image | None = None,
    dictionary: str = "",
    *,
    border_bits: int = 1,
    inverted: bool = False,
) -> Detections:
    """Return the robots in an image, from the detections of their markers.

    Centre, heading, side and corners are those of a marker of side 1 at the robot's reference point, flat on
    the ground. Covariances are zero for robots of which all markers have none. The quality is the least of
    the markers'. Markers that are on no robot stay as they are, after the robots.

    Args:
        found: the markers in an image.
        layout: the markers on the robots.
        image: grey, (height, width), in which the markers were found; needed unless the layout is flat.
        dictionary: name of the markers' dictionary; needed with `image`.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.

    Raises:
        InputError: the layout is not flat, and no image is given.
    """
    check_kind("fuse_markers: found", found, Detections, "Detections")
    check_kind("fuse_markers: layout", layout, MarkerLayout, "a MarkerLayout")
    if layout.is_flat:
        return fuse_planar_markers(found, layout)
    if image is None:
        raise InputError("fuse_markers: image", "None, but markers lie on several faces", "the image")
    on_robots = found.select(layout.ids)
    corners_px, covariances = measure_outlines(
        image, on_robots, dictionary, border_bits=border_bits, inverted=inverted
    )
    others = found.without(layout.ids)
    return fuse_spatial_markers(on_robots, corners_px, covariances, layout, others)
