"""Validation of a labelled image set: files, layouts against the truth, truth against spec and pixels."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skyherd.datasets.labelled.agreement import Agreement, look
from skyherd.datasets.labelled.coco import coco_document
from skyherd.datasets.labelled.folder import Folder, open_folder, same_version
from skyherd.datasets.labelled.labels import Labels, make_labels
from skyherd.datasets.labelled.read import Dataset, LabelledImage, read_dataset
from skyherd.datasets.labelled.sampling import make_scene
from skyherd.datasets.labelled.scenes import Scene
from skyherd.datasets.labelled.yolo import COLUMNS, folder_yaml, yolo_table
from skyherd.errors import InputError
from skyherd.geometry import Array

PLACE_TOLERANCE_PX = 1e-4
"""What a layout may differ from the table: both are written to a millionth of a pixel or better."""

YOLO_TOLERANCE = 1e-6

PIXEL_TOLERANCE = 1.0
"""Mean difference, grey levels, that versions of OpenCV may make: other noise alone makes as much."""


@dataclass(frozen=True)
class Verdict:
    """What was found wrong, a line each, and how the detector agrees with the truth, where it was asked."""

    problems: list[str]
    images: int
    markers: int
    agreement: Agreement | None


def check_dataset(path: Path, *, sample: int = 24) -> Verdict:
    """Check all files of a set, and the pixels of so many images, evenly spread.

    Raises:
        InputError: the folder is not that of a data set.
    """
    folder = open_folder(path)
    try:
        dataset = read_dataset(path)
    except InputError as error:
        return Verdict([str(error)], folder.spec.images, 0, None)
    problems = [*_check_images(dataset), *_check_coco(folder, dataset), *_check_yolo(folder, dataset)]
    count = min(sample, len(dataset))
    chosen = [int(k) for k in np.arange(count) * len(dataset) // max(count, 1)]
    if same_version(path):
        problems += _check_seed(dataset, chosen)
    agreement, doubts = look([dataset[k] for k in chosen], dataset.spec.markers.dictionary)
    return Verdict(problems + doubts, len(dataset), dataset.markers, agreement)


def _check_images(dataset: Dataset) -> Iterator[str]:
    """Every image is there, whole, and of its size."""
    width, height = dataset.spec.size_px
    for image in dataset:
        try:
            shape = image.read().shape
        except InputError as error:
            yield str(error)
            continue
        if shape != (height, width):
            yield f"{image.path}: {shape[1]}x{shape[0]} px, its spec says {width}x{height}"


def _check_coco(folder: Folder, dataset: Dataset) -> Iterator[str]:
    """Each COCO file says what the truth table says."""
    for split in folder.splits():
        file = folder.coco(split)
        try:
            found = json.loads(file.read_text("utf-8"))
        except OSError as error:
            yield f"{file}: {error.strerror}"
            continue
        except ValueError:
            yield f"{file}: no JSON, or cut short"
            continue
        images = [(i, dataset[i].path.name, dataset[i].labels) for i in folder.indices(split)]
        wanted = coco_document(dataset.spec.description, dataset.spec.size_px, images)
        yield from (f"{file}: {line}" for line in _compare_coco(found, wanted))


def _compare_coco(found: Any, wanted: dict[str, Any]) -> Iterator[str]:
    if not isinstance(found, dict):
        yield "no COCO document"
        return
    for part in ("categories", "images", "annotations"):
        try:
            entries = {entry["id"]: entry for entry in found[part]}
        except (KeyError, TypeError):
            yield f"no {part}, or one without an id"
            continue
        ids = {entry["id"] for entry in wanted[part]}
        if len(entries) != len(found[part]) or entries.keys() != ids:
            yield f"{len(found[part])} {part}, of {len(ids)} that the truth table has, or not with their ids"
        for entry in wanted[part]:
            if entry["id"] in entries:
                yield from _compare_entry(entries[entry["id"]], entry, part)


def _compare_entry(found: dict[str, Any], wanted: dict[str, Any], part: str) -> Iterator[str]:
    """The first difference of an image, annotation or category."""
    for key, value in wanted.items():
        if not _alike(found.get(key), value):
            of = (
                f" of image {wanted['image_id']:06d}, marker {wanted['marker_id']}"
                if part == "annotations"
                else ""
            )
            yield f"{part}: {key} of id {wanted['id']}{of} is {found.get(key)}, by the truth table {value}"
            return


def _alike(found: Any, wanted: Any) -> bool:
    if isinstance(wanted, list):
        return (
            isinstance(found, list)
            and len(found) == len(wanted)
            and all(_alike(a, b) for a, b in zip(found, wanted, strict=True))
        )
    if isinstance(wanted, float) and isinstance(found, int | float):
        return abs(found - wanted) <= PLACE_TOLERANCE_PX
    return bool(found == wanted)


def _check_yolo(folder: Folder, dataset: Dataset) -> Iterator[str]:
    """Each YOLO file says what the truth table says."""
    for index, image in enumerate(dataset):
        file = folder.yolo(index)
        try:
            rows = [[float(word) for word in line.split()] for line in file.read_text("utf-8").splitlines()]
        except OSError as error:
            yield f"{file}: {error.strerror}"
            continue
        except ValueError:
            yield f"{file}: not all of it is numbers"
            continue
        wanted = yolo_table(image.labels, dataset.spec.size_px)
        if [len(row) for row in rows] != [COLUMNS] * len(wanted):
            yield f"{file}: {len(rows)} lines; by the truth table {len(wanted)}, of {COLUMNS} numbers"
        elif rows and (far := np.abs(np.array(rows) - wanted).max(axis=1)).max() > YOLO_TOLERANCE:
            line = int(far.argmax())
            marker = image.labels.ids[line]
            yield f"{file}: line {line + 1} is off by {far[line]:.2g} from marker {marker} of the truth table"
    file = folder.data_yaml
    if not file.exists() or file.read_text("utf-8", errors="replace") != folder_yaml(folder):
        yield f"{file}: not there, or not what its spec makes of it"


def _check_seed(dataset: Dataset, chosen: list[int]) -> Iterator[str]:
    """Table and pixels are what spec and seed make of them."""
    table = dataset.path / "truth.csv"
    for index in chosen:
        image, scene = dataset[index], make_scene(dataset.spec, index)
        if complaint := _differs(image.labels, make_labels(scene)):
            yield f"{table}: {image.name}: {complaint}"
        if scene.station.ground.image is None and _repainted(image, scene):
            yield f"{image.path}: its pixels are not those of its seed"


def _differs(found: Labels, wanted: Labels) -> str | None:
    if not np.array_equal(found.ids, wanted.ids):
        return f"has markers {found.ids.tolist()}, by its seed {wanted.ids.tolist()}"
    pairs = zip(_numbers(found), _numbers(wanted), strict=True)
    far = [np.abs(here - there).max() > PLACE_TOLERANCE_PX for here, there in pairs]
    return f"markers {wanted.ids[far].tolist()} are not as its seed puts them" if any(far) else None


def _repainted(image: LabelledImage, scene: Scene) -> bool:
    """Whether an image that can be read differs from what its seed gives."""
    try:
        found, wanted = image.read(), scene.render(Path())
    except InputError:
        return False  # told elsewhere
    return found.shape == wanted.shape and float(cv2.absdiff(found, wanted).mean()) > PIXEL_TOLERANCE


def _numbers(labels: Labels) -> Array:
    """All numbers of each marker (N, K)."""
    columns = (
        labels.keypoints_px.reshape(-1, 10),
        labels.headings_deg,
        labels.sides_px,
        labels.visible_fractions,
        labels.visibilities,
        labels.crb_stds,
    )
    return np.column_stack(columns)
