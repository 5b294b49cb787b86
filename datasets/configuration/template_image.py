"""Reads a template from a picture: the shape is where its markers are."""

from pathlib import Path

from skyherd.control import Template
from skyherd.errors import InputError
from skyherd.files.images import read_grey
from skyherd.vision import create_detector, explain_mirrored

MAX_PIXELS = 50_000_000
"""Pixels of the largest picture that a template is read from. *Chosen*: larger than usual cameras'; the
markers are looked for when the scenario is checked, which should take seconds."""


def read_template_image(path: Path, dictionary: str) -> Template:
    """Read a template from a picture file: a point for each marker found, at its centre.

    Raises:
        InputError: the file cannot be read, or fewer than two markers are found in it.
    """
    grey = read_grey(path, max_pixels=MAX_PIXELS)
    found = create_detector(dictionary=dictionary).detect(grey)
    why = explain_mirrored(grey, dictionary)
    if why is None and len(found) < 2:
        why = f"{len(found)} marker(s) of {dictionary} found"
    if why is not None:
        raise InputError(str(path), why, "a top view with every robot's marker, each with a white quiet zone")
    return Template.from_image_points(found.ids, found.centers_px)
