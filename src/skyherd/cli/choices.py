"""Values that options take, for their help texts and for shell completion, known without loading the package.

The lists are written out, since loading what they come from would take longer than the help itself. A test
compares them with the code. The code that uses a value checks it.
"""

from importlib.util import find_spec
from pathlib import Path

DETECTORS = (
    "apriltag3",
    "locus-tag",
    "napa",
    "opencv",
    "opencv-apriltag",
    "opencv-contour",
    "opencv-subpix",
    "photometric",
    "quick",
    "tracking",
)
"""Names of the detectors, as `skyherd.vision.detector_names` gives them."""

DICTIONARIES = (
    *(f"{bits}_{size}" for bits in ("4X4", "5X5", "6X6", "7X7") for size in (50, 100, 250, 1000)),
    "5X5_1900",
    "6X6_1900",
    "6X6_7900",
    "7X7_8000",
    "ARUCO_ORIGINAL",
    "ARUCO_MIP_36h12",
    "APRILTAG_16h5",
    "APRILTAG_25h9",
    "APRILTAG_36h10",
    "APRILTAG_36h11",
)
"""Names of the marker dictionaries, as `skyherd.markers.dictionary` gives them."""

PAPERS = ("A5", "A4", "A3", "A2", "A1", "A0", "Letter", "Legal", "Tabloid")
"""Names of the papers that sheets of markers are made for."""

PERCEPTIONS = ("rendered", "ideal", "noisy")
"""Ways in which a run's units get their detections."""

TABLE_FORMATS = ("csv", "jsonl")
"""Formats of the table of detections."""

EXPORT_FORMATS = ("csv", "parquet", "rosbag2", "coco")
"""Formats of an exported run."""


def complete_detector(incomplete: str) -> list[str]:
    """Return the detectors whose names begin with the typed text."""
    return _begin(DETECTORS, incomplete)


def complete_paper(incomplete: str) -> list[str]:
    """Return the papers whose names begin with the typed text."""
    return _begin(PAPERS, incomplete)


def complete_perception(incomplete: str) -> list[str]:
    """Return the kinds of perception whose names begin with the typed text."""
    return _begin(PERCEPTIONS, incomplete)


def complete_format(incomplete: str) -> list[str]:
    """Return the formats of a table whose names begin with the typed text."""
    return _begin(TABLE_FORMATS, incomplete)


def complete_export_format(incomplete: str) -> list[str]:
    """Return the formats of an exported run whose names begin with the typed text."""
    return _begin(EXPORT_FORMATS, incomplete)


def complete_dictionary(incomplete: str) -> list[str]:
    """Return the marker dictionaries whose names begin with the typed text."""
    return _begin(DICTIONARIES, incomplete)


def complete_scenario(incomplete: str) -> list[str]:
    """Return the built-in scenarios, TOML files and folders that begin with the typed text."""
    return _built_in("skyherd.datasets", "scenarios", incomplete) + _toml_files(incomplete)


def complete_spec(incomplete: str) -> list[str]:
    """Return the built-in specs of image sets, TOML files and folders that begin with the typed text."""
    return _built_in("skyherd.datasets", "specs", incomplete) + _toml_files(incomplete)


def complete_study(incomplete: str) -> list[str]:
    """Return the built-in studies, TOML files and folders that begin with the typed text."""
    return _built_in("skyherd.study", "specs", incomplete) + _toml_files(incomplete)


def _begin(names: tuple[str, ...] | list[str], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


def _built_in(package: str, folder: str, incomplete: str) -> list[str]:
    """Return the names of the TOML files in a folder of a package, without importing it."""
    spec = find_spec(package)
    places = (spec.submodule_search_locations or []) if spec else []
    return _begin(
        sorted(file.stem for place in places for file in Path(place, folder).glob("*.toml")), incomplete
    )


def _toml_files(incomplete: str) -> list[str]:
    """Return the TOML files, and the folders with a slash, whose paths begin with the typed text."""
    folder = Path(incomplete).parent if not incomplete.endswith("/") else Path(incomplete)
    if not folder.is_dir():
        return []
    paths = sorted(path for path in folder.iterdir() if path.is_dir() or path.suffix == ".toml")
    return _begin([f"{path}/" if path.is_dir() else str(path) for path in paths], incomplete)
