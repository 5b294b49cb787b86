"""Sets of photographs with markers: files and marker properties, from a TOML file beside them.

Each set has a table of its name:

```toml
[wall]
files = ["wall_*.jpg", "hall/*.png"]     # patterns, from the folder of the images
dictionary = "APRILTAG_36h11"
border_bits = 1                          # cells of the black border; 2 on some calibration boards
inverted = false                         # whether markers are white on black
ids_repeat = false                       # whether an image may show several markers of one id
every = 1                                # of videos, every frame, or every second, third, …
half = "test"                            # "tuning" for sources that work on a detector may look at
```

Its table `board` gives the marker positions of a calibration board (`skyherd.bench.boards.layout`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field

from skyherd.bench.boards.layout import BoardModel
from skyherd.datasets import (
    DictionaryName,
    Model,
    check_tree,
    parse_toml,
    read_toml_text,
    refuse_other_kind,
)
from skyherd.errors import InputError, ProblemCollector
from skyherd.files.images import SUFFIXES, read_grey
from skyherd.files.video_reader import VIDEO_SUFFIXES, is_video, open_clip, read_clip
from skyherd.text import one_of

SETS_FILE = "photographs.toml"
"""Name of the sets' file in the folder of the images."""

EXAMPLE = "skyherd bench photographs --help"
"""Command that describes the format, for error messages."""


class ImageSetModel(Model):
    """One set of images: files, and common properties of their markers."""

    files: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        description="patterns of file names, from the folder of the images"
    )
    dictionary: DictionaryName = Field(description="of the markers, such as APRILTAG_36h11")
    border_bits: Annotated[int, Field(ge=1, le=4)] = Field(1, description="cells of the black border")
    inverted: bool = Field(False, description="whether markers are white on black")
    ids_repeat: bool = Field(False, description="whether an image may show several markers of one id")
    every: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        1, description="of videos, the distance between frames that are taken: 2 is every second one"
    )
    half: Literal["tuning", "test"] | None = Field(
        None, description="whether work on detectors may look at these images (tuning) or not (test)"
    )
    board: BoardModel | None = Field(None, description="the calibration board that all images show")


@dataclass(frozen=True)
class ImageSet:
    """A set of existing images.

    Attributes:
        name: name of the set.
        model: its table.
        files: pictures and videos, sorted by name; at least one.
    """

    name: str
    model: ImageSetModel
    files: tuple[Path, ...]

    @property
    def dictionary(self) -> str:
        """Name of the dictionary for detectors."""
        return self.model.dictionary

    def images(self) -> Iterator[tuple[str, npt.NDArray[np.uint8]]]:
        """Read the images one by one: file name, with the frame number for videos, and grey levels.

        Raises:
            InputError: a file cannot be read.
        """
        for path in self.files:
            if not is_video(path):
                yield path.name, read_grey(path)
                continue
            for frame in read_clip(open_clip(path)):
                if frame.index % self.model.every == 0:
                    yield f"{path.name}#{frame.index}", frame.image

    def marker_options(self) -> dict[str, Any]:
        """Return the detector options of the markers beside their dictionary that are not default."""
        usual = {"border_bits": 1, "inverted": False}
        told = {key: getattr(self.model, key) for key in usual}
        return {key: value for key, value in told.items() if value != usual[key]}


def load_image_sets(
    folder: Path, sets_file: Path | None = None, *, only: tuple[str, ...] = ()
) -> list[ImageSet]:
    """Read the sets of a folder of images.

    Args:
        folder: folder of the images.
        sets_file: the TOML file; by default `photographs.toml` in the folder.
        only: names of the sets to load; all if empty.

    Returns:
        the sets in the order of the file, without those that have no existing file.

    Raises:
        InputError: the folder or file is missing, a key is wrong, a set is unknown, or there is no image.
    """
    if not folder.is_dir():
        raise InputError(str(folder), "no such folder", f"a folder of images with a {SETS_FILE} in it")
    path = sets_file or folder / SETS_FILE
    tables = parse_toml(read_toml_text(path, "file of image sets"), str(path), EXAMPLE)
    refuse_other_kind(tables, str(path), "file of image sets")
    if unknown := [name for name in only if name not in tables]:
        what = f"{path} has no set {', '.join(unknown)}"
        raise InputError("only", what, one_of(unknown[0], tables))
    problems, models = ProblemCollector(), {}
    for name, table in tables.items():
        with problems.collecting():
            models[name] = _parse_set(table, f"{path}: [{name}]")
    problems.raise_all()
    sets = []
    for name, model in models.items():
        files = _find(folder, model.files, f"{path}: [{name}]")
        if files and (not only or name in only):
            sets.append(ImageSet(name, model, files))
    if not sets:
        raise InputError(str(folder), f"no image of the sets in {path}", "patterns that match files there")
    return sets


def read_files(image_sets: Sequence[ImageSet], folder: Path, sets_file: Path | None = None) -> list[Path]:
    """List all files that a measurement of these sets reads, none of which may be written to."""
    return [sets_file or folder / SETS_FILE, *(file for found in image_sets for file in found.files)]


def _parse_set(table: Any, where: str) -> ImageSetModel:
    if not isinstance(table, dict):
        raise InputError(where, "is not a table", "[NAME] with files and dictionary below it")
    model = check_tree(ImageSetModel, table, where, see=EXAMPLE)
    if model.board is not None:
        model.board.check_dictionary(model.dictionary, f"{where}.board")
    return model


def _find(folder: Path, patterns: tuple[str, ...], where: str) -> tuple[Path, ...]:
    """Find the pictures and videos that match one of the patterns, each once, sorted by path.

    Raises:
        InputError: a pattern is invalid: empty, or absolute.
    """
    found = set[Path]()
    for pattern in patterns:
        try:
            found |= set(folder.glob(pattern))
        except (ValueError, NotImplementedError, OSError) as error:
            what = f"{pattern!r}: {error}"
            raise InputError(f"{where}.files", what, "patterns such as *.jpg or hall/*.png") from None
    return tuple(sorted(p for p in found if p.suffix.lower() in SUFFIXES | VIDEO_SUFFIXES))
