"""Generation of a labelled image set, in parallel; interrupted sets are continued.

An image and its labels follow from spec and number alone. Existing images and labels are kept. A continued
set is therefore identical to the byte.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np

from skyherd.datasets.labelled.folder import Folder, open_output
from skyherd.datasets.labelled.formats.coco import coco_text
from skyherd.datasets.labelled.formats.truth_table import (
    TRUTH_COLUMNS,
    Row,
    image_row,
    table_text,
    truth_rows,
)
from skyherd.datasets.labelled.formats.yolo import folder_yaml, yolo_text
from skyherd.datasets.labelled.labels import Labels, make_labels
from skyherd.datasets.labelled.preview import write_preview
from skyherd.datasets.labelled.read import Dataset, read_dataset
from skyherd.datasets.labelled.sampling import make_scene, station_number
from skyherd.datasets.labelled.spec import SpecFile
from skyherd.errors import OutputError
from skyherd.files.atomic import write_text, write_whole
from skyherd.jobs.lifetime import start_worker
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.messages.checks import check_kind

BATCH = 8
"""Maximum number of images in a worker's batch, all of one camera. Chosen: rendering the ground of a camera
takes as long as some images, and a batch shares it. An interrupt waits for the end of a batch."""

Made = tuple[Labels, Row]
"""Labels of an image, and its row of the table of images."""


def make_dataset(file: SpecFile, path: Path, *, jobs: int = 1, progress: Progress = NO_PROGRESS) -> Dataset:
    """Make the set that a spec describes, or continue it, and read it back.

    Args:
        file: the spec with the folder of its pictures.
        path: the folder to make.
        jobs: number of processes.
        progress: receives the number of finished images after each batch.

    Raises:
        InputError: the folder holds something else.
        OutputError: a file cannot be written.
    """
    check_kind("make_dataset: file", file, SpecFile, "a SpecFile, as load_spec returns it")
    check_kind("make_dataset: path", path, Path, "a path")
    with open_output(path, file) as (folder, output):
        for split in folder.splits():
            for kind in ("images", "labels"):
                (path / kind / split).mkdir(parents=True, exist_ok=True)
        made: dict[int, Made] = {}
        for batch, results in _run(file, folder, jobs):
            output.keep()
            made |= dict(zip(batch, results, strict=True))
            progress.update("images", len(made), file.spec.images)
        _write_tables(folder, made)
        dataset = read_dataset(path)
        write_preview(dataset, folder.preview)
        return dataset


def make_images(file: SpecFile, folder: Folder, indices: Sequence[int]) -> list[Made]:
    """Write the images with the given numbers, and their YOLO labels, unless they exist.

    Returns:
        The labels and the table row of each image, in the given order.
    """
    return [_make_image(file, folder, index) for index in indices]


def _make_image(file: SpecFile, folder: Folder, index: int) -> Made:
    scene = make_scene(file.spec, index)
    labels, target = make_labels(scene), folder.image(index)
    if not folder.yolo(index).exists():
        write_text(folder.yolo(index), yolo_text(labels, file.spec.size_px))
    if not target.exists():
        _, data = cv2.imencode(".png", scene.render(file.folder))
        write_whole(target, lambda part: part.write_bytes(data.tobytes()))
    return labels, image_row(folder.image_name(index), folder.split(index), scene)


def _run(file: SpecFile, folder: Folder, jobs: int) -> Iterator[tuple[list[int], list[Made]]]:
    """Yield each batch with its results, in any order."""
    batches = _batches(file)
    if jobs == 1:
        for batch in batches:
            yield batch, make_images(file, folder, batch)
        return
    with ProcessPoolExecutor(
        min(jobs, len(batches)), mp_context=get_context("spawn"), initializer=_start_worker
    ) as pool:
        futures = {pool.submit(make_images, file, folder, batch): batch for batch in batches}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise OutputError(
                f"{folder.path}: a worker process was killed, possibly for lack of memory; "
                "the same command continues from here, with fewer `jobs=` if necessary"
            ) from None
        finally:
            pool.shutdown(cancel_futures=True)


def _start_worker() -> None:
    """Prepare a worker process: it ends with its parent, ignores interrupts, and has one thread."""
    start_worker()
    cv2.setNumThreads(1)


def _batches(file: SpecFile) -> list[list[int]]:
    """Return batches of image numbers, each of one camera."""
    stations = np.array([station_number(file.spec, index) for index in range(file.spec.images)])
    batches = []
    for station in np.unique(stations):
        indices = np.flatnonzero(stations == station)
        batches += [indices[first : first + BATCH].tolist() for first in range(0, len(indices), BATCH)]
    return batches


def _write_tables(folder: Folder, made: dict[int, Made]) -> None:
    """Write the files about the whole set."""
    spec = folder.spec
    for split in folder.splits():
        images = [(i, folder.image(i).name, made[i][0]) for i in folder.indices(split)]
        folder.coco(split).parent.mkdir(exist_ok=True)
        write_text(folder.coco(split), coco_text(spec.description, spec.size_px, images))
    write_text(folder.data_yaml, folder_yaml(folder))
    ordered = [(folder.image_name(i), made[i]) for i in range(spec.images)]
    rows = (row for name, (labels, _) in ordered for row in truth_rows(name, labels))
    write_text(folder.truth, table_text(rows, TRUTH_COLUMNS))
    write_text(folder.images, table_text([row for _, (_, row) in ordered], ordered[0][1][1]))
