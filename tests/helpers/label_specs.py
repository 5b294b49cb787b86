"""A small labelled set that tests vary."""

import functools
import tempfile
from pathlib import Path

from skyherd.datasets.labelled.make import make_dataset
from skyherd.datasets.labelled.spec import SpecFile, make_spec

TREE = {
    "seed": 5,
    "images": 10,
    "size_px": (320, 240),
    "validation": 0.3,
    "cameras": 3,
    "markers": {"count": (2, 5), "side_px": (24, 40), "cut": 0.15},
    "camera": {"tilt_deg": (0, 15), "psf_px": (0.6, 1.1), "distortion": {"k1": (-0.1, 0.05)}},
    "sensor": {"noise": (1, 5), "gain": (0.7, 1), "gradient": (0, 0.3), "shot": (0, 0.05)},
    "ground": {"kinds": ["plain", "tiles"], "clutter": (0, 4)},
    "occluders": {"share": 0.2},
}


def spec_of(**changes):
    """Return the small set with some keys changed."""
    return SpecFile(make_spec(TREE | changes))


@functools.cache
def labelled_set() -> dict[str, bytes]:
    """Return the files of a small set with one image, by name."""
    with tempfile.TemporaryDirectory() as folder:
        path = make_dataset(spec_of(images=1), Path(folder, "set")).path
        return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}
