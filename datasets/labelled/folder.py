"""Folder of a labelled image set: its layout, and the spec of the set.

- `spec.json`: the spec, SHA-256 of its pictures, the version of skyherd;
- `images/train`, `images/val`: 000000.png …, numbered consecutively over both splits;
- `labels/train`, `labels/val`: 000000.txt …, YOLO-pose; with `data.yaml`;
- `annotations/train.json`, `val.json`: COCO keypoints;
- `truth.csv`, `images.csv`: ground truth, one row per marker, and one per image;
- `preview.png`.
"""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from skyherd.datasets.configuration.file_kinds import DATASET
from skyherd.datasets.configuration.validation import input_error
from skyherd.datasets.labelled.spec import DatasetSpec, SpecFile
from skyherd.errors import InputError
from skyherd.files.atomic import write_text
from skyherd.files.output_folder import OutputFolder
from skyherd.files.reading import read_json

TRAIN, VAL = "train", "val"
"""Names of the splits: images for training, and images for validation."""

RECORD = "spec.json"
"""File with the spec of the set."""

VERB = "dataset make"
"""Verb in the record of output folders (`skyherd.files.output_folder`) for the files of a set."""

SPLITS = (TRAIN, VAL)
"""All splits, in the order of writing."""


@dataclass(frozen=True)
class Folder:
    """Folder of a set, whose layout follows from its spec.

    Attributes:
        path: the folder.
        spec: the spec of its content.
    """

    path: Path
    spec: DatasetSpec

    def split(self, index: int) -> str:
        """Return the split of an image, given by its number."""
        return VAL if self.spec.is_validation(index) else TRAIN

    def splits(self) -> list[str]:
        """Return the splits with at least one image."""
        there = {self.split(index) for index in range(self.spec.images)}
        return [split for split in SPLITS if split in there]

    def indices(self, split: str) -> list[int]:
        """Return the numbers of a split's images, ascending."""
        return [index for index in range(self.spec.images) if self.split(index) == split]

    def image_name(self, index: int) -> str:
        """Return an image's file relative to the folder, which is its name in the tables."""
        return f"images/{self.split(index)}/{index:06d}.png"

    def image(self, index: int) -> Path:
        """Return the file of an image."""
        return self.path / self.image_name(index)

    def yolo(self, index: int) -> Path:
        """Return the file of an image's YOLO labels."""
        return self.path / f"labels/{self.split(index)}/{index:06d}.txt"

    def coco(self, split: str) -> Path:
        """Return the COCO file of a split."""
        return self.path / f"annotations/{split}.json"

    @property
    def data_yaml(self) -> Path:
        """File that describes the set for YOLO's trainers."""
        return self.path / "data.yaml"

    @property
    def truth(self) -> Path:
        """Truth table, one row per marker."""
        return self.path / "truth.csv"

    @property
    def images(self) -> Path:
        """Table of images, one row per image."""
        return self.path / "images.csv"

    @property
    def preview(self) -> Path:
        """Contact sheet of some images with their labels."""
        return self.path / "preview.png"


def open_folder(path: Path) -> Folder:
    """Open the folder of a complete or an interrupted set.

    Raises:
        InputError: it has no record of a spec, or a damaged one.
    """
    return Folder(path, _read_record(path)[0])


def same_version(path: Path) -> bool:
    """Return True if this version of skyherd made the set in a folder; others may draw other images.

    Raises:
        InputError: it has no record of a spec, or a damaged one.
    """
    return bool(_read_record(path)[1].get("skyherd") == version("skyherd"))


@contextmanager
def open_output(path: Path, file: SpecFile) -> Iterator[tuple[Folder, OutputFolder]]:
    """Open the folder of a set for writing: a new folder, or one that was begun from the same spec.

    Raises:
        InputError: it holds something else, or a file of the same name that is not part of the set; or
            another process writes into it.
        OutputError: it cannot be made.
    """
    folder = Folder(path, file.spec)
    files = (
        folder.data_yaml,
        folder.truth,
        folder.images,
        folder.preview,
        *map(folder.coco, folder.splits()),
    )
    names = [RECORD, *(str(name.relative_to(path)) for name in files), "images/", "labels/"]
    if os.path.isdir(path) and any(path.iterdir()):
        _check_same(path, file)
    with OutputFolder(path, VERB, names, resume=True) as output:
        if not (path / RECORD).exists():
            write_text(path / RECORD, json.dumps(_contents(file), indent=2) + "\n")
        yield folder, output


def _record(path: Path) -> Path:
    return path / RECORD


def _contents(file: SpecFile) -> dict[str, Any]:
    spec = file.spec.model_dump(mode="json")
    return {"skyherd": version("skyherd"), "spec": spec, "pictures": file.pictures()}


def _check_same(path: Path, file: SpecFile) -> None:
    """Raise an error if the folder holds another set, or something else."""
    advice = "choose another `folder=`, or remove that folder"
    if not _record(path).exists():
        raise InputError(str(path), "is not the folder of a data set", advice)
    spec, record = _read_record(path)
    asked = _contents(file)
    if record.get("skyherd") != asked["skyherd"]:
        raise InputError(str(path), f"was made by skyherd {record.get('skyherd')}", advice)
    if record.get("pictures") != asked["pictures"]:
        raise InputError(str(path), "was made with other pictures of the ground", advice)
    given, made = asked["spec"], spec.model_dump(mode="json")
    if changed := [key for key in given if given[key] != made[key]]:
        raise InputError(str(path), f"holds a data set of another spec ({', '.join(changed)} differ)", advice)


def _read_record(path: Path) -> tuple[DatasetSpec, dict[str, Any]]:
    file, made = _record(path), "the folder of a data set that `skyherd dataset make` made"
    try:
        record = read_json(file, made)
        return DatasetSpec.model_validate_json(json.dumps(record["spec"])), record
    except ValidationError as error:
        raise input_error(error, DatasetSpec, str(file), see=DATASET.schema) from None
    except InputError:
        raise
    except (ValueError, TypeError, KeyError):
        raise InputError(str(file), "damaged", made) from None
