"""Ground truth of a set as two CSV tables: one row per marker, and one row per image with its camera.

`truth.csv`: image, id, u_px, v_px, heading_deg, side_px, the corners, visible_fraction, the visibility of
each keypoint, and the Cramér–Rao standard deviations. `images.csv`: image, split, size, and all inputs of the
image: intrinsics, distortion, pose over the ground (in marker sides), lens, sensor.
"""

import csv
import io
from collections import defaultdict
from collections.abc import Iterable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.datasets.labelled.labels import KEYPOINTS, Labels
from skyherd.datasets.labelled.scenes import Scene
from skyherd.errors import InputError
from skyherd.files.reading import read_text
from skyherd.geometry import Array
from skyherd.messages.detections import CORNER_COLUMNS

VISIBILITIES = [f"visibility_{name}" for name in KEYPOINTS]
"""Columns with the visibility of each keypoint."""


BOUNDS = ["crb_std_u_px", "crb_std_v_px", "crb_std_heading_deg"]
"""Columns with the Cramér–Rao standard deviations."""


NUMBERS = [
    "u_px",
    "v_px",
    "heading_deg",
    "side_px",
    *CORNER_COLUMNS,
    "visible_fraction",
    *VISIBILITIES,
    *BOUNDS,
]
"""Columns with numbers, in the order of `label_table`."""

TRUTH_COLUMNS = ["image", "id", *NUMBERS]
"""All columns of `truth.csv`."""

DIGITS = 9
"""Decimals of the numbers of `images.csv`. Chosen: as those of labels."""

MAX_BYTES = 2**30
"""Maximum size of a table, bytes. Chosen: rows of some millions of markers."""

MAX_IDS = 2**31
"""Upper limit of marker ids, exclusive. Chosen: far above the largest dictionary."""

Row = dict[str, Any]
"""Values of a row, by column."""


def label_table(labels: Labels) -> Array:
    """Return all numbers of an image's labels, (N, 22): a row per marker, a column for each of `NUMBERS`."""
    return np.column_stack(
        [
            labels.centers_px,
            labels.headings_deg,
            labels.sides_px,
            labels.corners_px.reshape(-1, 8),
            labels.visible_fractions,
            labels.visibilities,
            labels.crb_stds,
        ]
    )


def truth_rows(image: str, labels: Labels) -> list[Row]:
    """Return the rows of `truth.csv` for an image: its name, the marker's id, and `label_table`."""
    return [
        {"image": image, "id": marker_id, **dict(zip(NUMBERS, map(_plain, values), strict=True))}
        for marker_id, values in zip(labels.ids.tolist(), label_table(labels).tolist(), strict=True)
    ]


def _plain(value: float) -> float | int:
    """Convert whole numbers to integers."""
    return int(value) if value == int(value) else value


def image_row(image: str, split: str, scene: Scene) -> Row:
    """Return the row of `images.csv` for an image: all its inputs."""
    station, pose, sensor, camera = scene.station, scene.pose, scene.sensor, scene.camera
    matrix = camera.intrinsic_matrix()
    row = {
        "image": image,
        "split": split,
        "width_px": camera.size_px[0],
        "height_px": camera.size_px[1],
        "markers": len(scene.ids),
        "camera": station.number,
        "focal_u_px": matrix[0, 0],
        "focal_v_px": matrix[1, 1],
        "principal_u_px": matrix[0, 2],
        "principal_v_px": matrix[1, 2],
        **station.camera.distortion.model_dump(),
        "x_sides": pose.position_m[0],
        "y_sides": pose.position_m[1],
        "height_sides": pose.height_m,
        "yaw_deg": np.degrees(pose.yaw_rad),
        "tilt_u_deg": np.degrees(pose.tilt_rad[0]),
        "tilt_v_deg": np.degrees(pose.tilt_rad[1]),
        "black": scene.black,
        "white": scene.white,
        "motion_px": scene.motion_px,
        **sensor.model_dump(exclude={"row_time_s", "exposure_s", "lens_blur", "processing"}),
        **_in_sides(sensor.lens_blur.model_dump()),
        **sensor.processing.model_dump(),
        "ground": station.ground.image or station.ground.kind,
        "ground_mean": station.ground.mean,
        "ground_contrast": station.ground.contrast,
        "clutter": scene.clutter,
        "occluders": len(scene.occluders),
    }
    return {
        name: round(float(value), DIGITS) if isinstance(value, float) else value
        for name, value in row.items()
    }


def _in_sides(values: Row) -> Row:
    """Rename columns that end in `_m` to end in `_sides`; a side is 1 m."""
    return {f"{name[:-2]}_sides" if name.endswith("_m") else name: value for name, value in values.items()}


def table_text(rows: Iterable[Mapping[str, Any]], columns: Iterable[str]) -> str:
    """Return the text of a CSV file with these rows and columns; numbers keep every digit."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, list(columns), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def read_table(path: Path, needed: Iterable[str]) -> list[dict[str, str]]:
    """Read the rows of a CSV file, as texts by column.

    Raises:
        InputError: it cannot be read, or lacks a column of `needed`.
    """
    allowed = "a table that `skyherd dataset make` wrote"
    text = read_text(path, allowed, MAX_BYTES)
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
        rows, columns = list(reader), reader.fieldnames or []
    except csv.Error as error:
        raise InputError(str(path), f"cannot be read: {error}", allowed) from None
    if absent := [column for column in needed if column not in columns]:
        raise InputError(str(path), f"no column {absent[0]}", allowed)
    if any(None in row or None in row.values() for row in rows):
        raise InputError(str(path), "a row is longer or shorter than the first line", allowed)
    return rows


def read_labels(path: Path) -> dict[str, Labels]:
    """Read the labels of each image that has any from `truth.csv`, by the image's name.

    Raises:
        InputError: it cannot be read, or a value is not a number.
    """
    numbers: dict[str, list[list[float]]] = defaultdict(list)
    for line, row in enumerate(read_table(path, TRUTH_COLUMNS), start=2):
        try:
            values = [float(row[column]) for column in ("id", *NUMBERS)]
        except ValueError:
            values = [float("nan")]
        if not all(map(isfinite, values)):
            raise InputError(f"{path}: line {line}", "not all of its values are numbers", "a whole row")
        if not 0 <= values[0] < MAX_IDS or values[0] != int(values[0]):
            raise InputError(f"{path}: line {line}", f"id is {row['id']}", "a marker's number")
        numbers[row["image"]].append(values)
    return {image: _labels(np.array(values)) for image, values in numbers.items()}


def no_labels() -> Labels:
    """Return the labels of an image without markers."""
    return _labels(np.zeros((0, 1 + len(NUMBERS))))


def _labels(table: np.ndarray) -> Labels:
    ids, centers, heading, side, corners, fraction, visibilities, bounds = np.split(
        table, np.cumsum([1, 2, 1, 1, 8, 1, len(KEYPOINTS)]), axis=1
    )
    return Labels(
        ids=ids[:, 0].astype(np.int64),
        centers_px=centers,
        headings_deg=heading[:, 0],
        sides_px=side[:, 0],
        corners_px=corners.reshape(-1, 4, 2),
        visible_fractions=fraction[:, 0],
        visibilities=visibilities.astype(np.int64),
        crb_stds=bounds,
    )
