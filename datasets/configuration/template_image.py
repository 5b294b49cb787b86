"""Reads a template from a picture: the shape is where its markers are."""

from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from skyherd.control import Template
from skyherd.errors import InputError
from skyherd.vision import create_detector, explain_mirrored


def read_template_image(path: Path, dictionary: str) -> Template:
    """Read a template from a picture file: a point for each marker found, at its centre.

    Raises:
        InputError: the file cannot be read, or fewer than two markers are found in it.
    """
    try:
        with Image.open(path) as image:
            grey = np.array(image.convert("L"))
    except FileNotFoundError:
        raise InputError(str(path), "no such file", "a PNG with every robot's marker in it") from None
    except (UnidentifiedImageError, OSError) as error:
        raise InputError(str(path), f"not a readable image ({error})", "a PNG with markers") from None
    detector = create_detector("aruco", dictionary=dictionary)
    found = detector.detect(grey)
    why = explain_mirrored(grey, dictionary)
    if why is None and len(found) < 2:
        why = f"{len(found)} marker(s) of {dictionary} found"
    if why is not None:
        raise InputError(str(path), why, "a top view with every robot's marker, each with a white quiet zone")
    return Template.from_image_points(found.ids, found.centers_px)
