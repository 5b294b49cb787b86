"""Checks of a labelled image set: its files, its formats, its ground truth and its pixels.

The truth table alone determines the COCO and YOLO files, which are generated again and compared byte by byte.
Spec and seed determine truth and pixels. These are compared within tolerances, because processors and
versions of OpenCV differ in the last digits. Finally, the detector runs on a sample of the images.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import zip_longest
from math import isfinite
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from skyherd.datasets.labelled.agreement import Agreement, look
from skyherd.datasets.labelled.folder import Folder, open_folder, same_version
from skyherd.datasets.labelled.formats.coco import coco_text
from skyherd.datasets.labelled.formats.truth_table import image_row, label_table
from skyherd.datasets.labelled.formats.yolo import folder_yaml, yolo_text
from skyherd.datasets.labelled.labels import Labels, make_labels
from skyherd.datasets.labelled.read import Dataset, LabelledImage, read_dataset
from skyherd.datasets.labelled.sampling import make_scene
from skyherd.datasets.labelled.scenes import Scene
from skyherd.errors import InputError
from skyherd.files.reading import MAX_JSON_BYTES, parse_json, read_bytes

MAX_SHOWN = 60
"""Maximum number of characters of a JSON value in a message. Chosen: a number or a name, within one line."""

TABLE_TOLERANCE = 1e-4
"""Maximum difference between a number of the truth table and the one from its seed; px, deg or fractions.
Chosen: far below the accuracy of any measurement, and far above the rounding differences of processors. The
table is written to 1e-9."""

PIXEL_TOLERANCE = 1.0
"""Maximum mean difference between an image and the one from its seed, grey levels. Chosen: differences
between versions of OpenCV are smaller; other noise alone makes as much."""

PATCH_PX, PATCH_TOLERANCE = 16, 8.0
"""Side of a square patch of an image, px, and maximum mean difference in the worst patch, grey levels.
Chosen: a patch is smaller than any legible marker. A painted-over object changes it by some tens of grey
levels; versions of OpenCV differ by less than one."""


@dataclass(frozen=True)
class Verdict:
    """Result of a check.

    Attributes:
        problems: one line for each problem; empty for a valid set.
        images: number of images.
        markers: number of labelled markers in them; 0 if the tables cannot be read.
        agreement: agreement of the detector with the truth; None if the tables cannot be read.
    """

    problems: list[str]
    images: int
    markers: int
    agreement: Agreement | None


def check_dataset(path: Path, *, sample: int = 24) -> Verdict:
    """Check all files of a set, and truth and pixels of `sample` images, evenly spread over it.

    Raises:
        InputError: the folder is not that of a labelled image set.
    """
    folder = open_folder(path)
    try:
        dataset = read_dataset(path)
    except InputError as error:
        return Verdict(problems=[str(error)], images=folder.spec.images, markers=0, agreement=None)
    problems = [
        *_check_strangers(folder),
        *_check_table(dataset),
        *_check_images(dataset),
        *_check_coco(folder, dataset),
        *_check_yolo(folder, dataset),
    ]
    count = min(sample, len(dataset))
    chosen = [int(k) for k in np.arange(count) * len(dataset) // max(count, 1)]
    if same_version(path):
        problems += _check_seed(dataset, chosen)
    agreement, doubts = look([dataset[k] for k in chosen], dataset.spec.markers.dictionary)
    return Verdict(
        problems=problems + doubts, images=len(dataset), markers=dataset.markers, agreement=agreement
    )


def _check_strangers(folder: Folder) -> Iterator[str]:
    """Yield a problem for each foreign file in the folders that training tools read."""
    indices = range(folder.spec.images)
    known = {
        *map(folder.image, indices),
        *map(folder.yolo, indices),
        *map(folder.coco, folder.splits()),
    }
    for kind in ("images", "labels", "annotations"):
        for path in sorted((folder.path / kind).rglob("*")):
            if path not in known and not path.is_dir():
                yield f"{path}: is not a file of the set, but training tools would read it"


def _check_table(dataset: Dataset) -> Iterator[str]:
    """Yield a problem for each number of the table of images that is not finite."""
    for image in dataset:
        for column, text in image.taken.items():
            if not isfinite(_number(text)):
                yield f"{dataset.path / 'images.csv'}: {image.name}: {column} is {text}"


def _number(text: str) -> float:
    """Return the value of a number in text form; 0 for other texts, such as names."""
    try:
        return float(text)
    except ValueError:
        return 0.0


def _check_images(dataset: Dataset) -> Iterator[str]:
    """Yield a problem for each image that is missing, damaged or of another size."""
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
    """Yield a problem for each COCO file that differs from the text made from the truth table."""
    for split in folder.splits():
        images = [(i, dataset[i].path.name, dataset[i].labels) for i in folder.indices(split)]
        text = coco_text(dataset.spec.description, dataset.spec.size_px, images)
        yield from _compare(folder.coco(split), text, "the truth table", _json_difference)


def _check_yolo(folder: Folder, dataset: Dataset) -> Iterator[str]:
    """Yield a problem for each YOLO file that differs from the text made from the truth table."""
    for index, image in enumerate(dataset):
        text = yolo_text(image.labels, dataset.spec.size_px)
        yield from _compare(folder.yolo(index), text, "the truth table", _line_difference)
    yield from _compare(folder.data_yaml, folder_yaml(folder), "its spec", _line_difference)


def _compare(file: Path, wanted: str, source: str, explain: Callable[[str, str], str]) -> Iterator[str]:
    """Yield a problem if a file is unreadable, or differs from the expected text: the first difference."""
    try:
        found = read_bytes(file, "make it again", MAX_JSON_BYTES)
    except InputError as error:
        yield str(error)
        return
    if found != wanted.encode():
        difference = explain(found.decode(errors="replace"), wanted)
        yield f"{file}: differs from {source}: {difference}"


def _line_difference(found: str, wanted: str) -> str:
    """Return the first line, and the first word in it, in which a text differs from the expected text."""
    lines = list(zip_longest(found.splitlines(), wanted.splitlines()))
    for number, (here, there) in enumerate(lines, start=1):
        if here is None or there is None:
            break
        for place, (word, right) in enumerate(zip_longest(here.split(), there.split()), start=1):
            if word != right:
                return f"line {number}, value {place} is {word} instead of {right}"
    return f"{len(found.splitlines())} lines instead of {len(wanted.splitlines())}"


def _json_difference(found: str, wanted: str) -> str:
    """Return the first dotted key at which a JSON document differs from the expected one."""
    try:
        document = parse_json(found)
    except json.JSONDecodeError:
        return "no JSON, or cut short"
    except ValueError as error:
        return str(error)
    nodes = [("", document, json.loads(wanted))]
    while nodes:
        key, here, there = nodes.pop()
        if isinstance(here, dict) and isinstance(there, dict) and here.keys() == there.keys():
            nodes += [(f"{key}.{name}", here[name], there[name]) for name in reversed(there)]
        elif isinstance(here, list) and isinstance(there, list) and len(here) == len(there):
            nodes += [(f"{key}.{k}", here[k], there[k]) for k in reversed(range(len(there)))]
        elif isinstance(here, list) and isinstance(there, list):
            return f"{key[1:]} has {len(here)} entries instead of {len(there)}"
        elif here != there:
            return f"{key[1:]} is {_shown(here)} instead of {_shown(there)}"
    return "the right content, but not the text that `skyherd dataset make` writes"


def _shown(value: Any) -> str:
    """Return a JSON value for a message; long texts are shortened."""
    text = json.dumps(value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"


def _check_seed(dataset: Dataset, chosen: list[int]) -> Iterator[str]:
    """Yield a problem for each image whose table rows or pixels differ from those of spec and seed."""
    table = dataset.path / "truth.csv"
    for index in chosen:
        image, scene = dataset[index], make_scene(dataset.spec, index)
        if complaint := _differs(image.labels, make_labels(scene)):
            yield f"{table}: {image.name}: {complaint}"
        wanted = image_row(image.name, image.split, scene)
        if column := next((name for name in wanted if _is_other(image.taken.get(name), wanted[name])), None):
            yield f"{dataset.path / 'images.csv'}: {image.name}: {column} is not as its seed gives it"
        if scene.station.ground.image is None and (complaint := _repainted(image, scene)):
            yield f"{image.path}: {complaint}"


def _differs(found: Labels, wanted: Labels) -> str | None:
    """Return the difference between an image's rows of the truth table and those from its seed, or None."""
    if not np.array_equal(found.ids, wanted.ids):
        return f"has markers {found.ids.tolist()}, by its seed {wanted.ids.tolist()}"
    far = (np.abs(label_table(found) - label_table(wanted)) > TABLE_TOLERANCE).any(axis=1)
    return f"markers {wanted.ids[far].tolist()} are not as its seed puts them" if far.any() else None


def _is_other(found: str | None, wanted: object) -> bool:
    """Return True if a text of the table of images differs from the expected value beyond the tolerance."""
    if isinstance(wanted, int | float) and found is not None:
        try:
            return abs(float(found) - wanted) > TABLE_TOLERANCE
        except ValueError:
            return found != str(wanted)  # such as True
    return found != ("" if wanted is None else str(wanted))


def _repainted(image: LabelledImage, scene: Scene) -> str | None:
    """Return the difference between the pixels of a readable image and those from its seed, or None."""
    try:
        found, wanted = image.read(), scene.render(Path())
    except InputError:
        return None  # `_check_images` reports it
    if found.shape != wanted.shape:
        return None
    difference = cv2.absdiff(found, wanted).astype(np.float32)
    if float(difference.mean()) > PIXEL_TOLERANCE:
        return "its pixels are not those of its seed"
    patches = cv2.blur(difference, (PATCH_PX, PATCH_PX))
    v, u = np.unravel_index(int(patches.argmax()), patches.shape)
    return (
        f"its pixels around ({u}, {v}) are not those of its seed" if patches[v, u] > PATCH_TOLERANCE else None
    )
