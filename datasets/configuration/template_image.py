"""Template from a picture: the shape is given by the markers in it."""

from pathlib import Path

from skyherd.control import Template
from skyherd.errors import InputError
from skyherd.files.images import read_grey
from skyherd.vision import create_detector, explain_mirrored

MAX_PIXELS = 50_000_000
"""Maximum number of pixels of a template picture. Chosen: above usual cameras; detection of the markers,
which runs during validation, should take seconds."""


def read_template_image(path: Path, dictionary: str) -> Template:
    """Read a template from a picture file: a point at the centre of each detected marker.

    Raises:
        InputError: the file is unreadable or mirrored, or has fewer than two detected markers.
    """
    grey = read_grey(path, max_pixels=MAX_PIXELS)
    found = create_detector(dictionary=dictionary).detect(grey)
    why = explain_mirrored(grey, dictionary)
    if why is None and len(found) < 2:
        why = f"{len(found)} marker(s) of {dictionary} found"
    if why is not None:
        raise InputError(str(path), why, "a top view with every robot's marker, each with a white quiet zone")
    return Template.from_image_points(found.ids, found.centers_px)
