"""Files of a survey: tables of markers and cameras, the frame as JSON, and a plan."""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.files.atomic import whole_file, write_text, write_whole
from skyherd.files.output_folder import OutputFolder
from skyherd.geometry import Array
from skyherd.plots.style import DPI
from skyherd.survey.measure import CameraPose, MarkerPose, Survey
from skyherd.survey.plan import draw_plan
from skyherd.text import table_cell

MARKERS = "markers.csv"
"""File of the markers' poses, a row each."""

CAMERAS = "cameras.csv"
"""File of the cameras' poses, a row each."""

FRAME = "frame.json"
"""File of all poses in full precision, with their joint covariance."""

PLAN = "plan.png"
"""File of the plan."""

VERB = "survey"
"""Verb under which the folder's record lists the files."""

AXES = "xyz"

POSE_COLUMNS = [
    *(f"{axis}_m" for axis in AXES),
    *(f"turn_{axis}_rad" for axis in AXES),
    *(f"std_{axis}_m" for axis in AXES),
    *(f"std_turn_{axis}_rad" for axis in AXES),
]
"""Columns of a pose in the frame: position, rotation vector, standard deviations."""


def write_survey(found: Survey, folder: Path, *, inputs: Sequence[Path] = (), force: bool = False) -> None:
    """Write the tables, the frame and the plan of a survey into a folder.

    Args:
        found: the survey.
        folder: created if missing.
        inputs: files that must not be replaced.
        force: accept an existing folder; only files of an earlier survey are replaced.

    Raises:
        InputError: the folder exists, or a foreign file in it would be replaced.
        OutputError: writing failed.
    """
    with output_folder(folder, inputs=inputs, force=force):
        _write_table(folder / MARKERS, ["id", "picture"], [_marker_row(one) for one in found.markers])
        _write_table(folder / CAMERAS, ["picture"], [_camera_row(one) for one in found.cameras])
        write_text(folder / FRAME, json.dumps(_record(found), indent=1) + "\n")
        figure = draw_plan(found)
        write_whole(folder / PLAN, lambda part: figure.savefig(part, format="png", dpi=DPI))


def output_folder(folder: Path, *, inputs: Sequence[Path] = (), force: bool = False) -> OutputFolder:
    """Return the output folder of a survey; its `check` rejects what writing would."""
    return OutputFolder(folder, VERB, [MARKERS, CAMERAS, FRAME, PLAN], force=force, inputs=inputs)


def _write_table(path: Path, first: list[str], rows: list[dict[str, Any]]) -> None:
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, [*first, *POSE_COLUMNS], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _marker_row(marker: MarkerPose) -> dict[str, Any]:
    picture = None if marker.view is None else table_cell(marker.view)
    return {"id": marker.id, "picture": picture, **_pose_columns(marker)}


def _camera_row(camera: CameraPose) -> dict[str, Any]:
    return {"picture": table_cell(camera.view), **_pose_columns(camera)}


def _pose_columns(pose: MarkerPose | CameraPose) -> dict[str, float]:
    """Return the values of `POSE_COLUMNS`, rounded to six significant digits."""
    turn = Rotation.from_matrix(pose.rotation).as_rotvec()
    values = [*pose.position_m, *turn, *np.sqrt(np.diag(pose.covariance))]
    return {name: float(f"{value:.6g}") for name, value in zip(POSE_COLUMNS, values, strict=True)}


def _record(found: Survey) -> dict[str, Any]:
    """Return the survey for JSON, in full precision; `joint_covariance` has markers first, then cameras."""
    return {
        "reference": found.reference,
        "side_m": found.side_m,
        "consistent": found.is_consistent,
        "variance_factor": found.variance_factor,
        "chi_squared": found.frame.chi_squared,
        "degrees_of_freedom": found.frame.freedoms,
        "markers": [{"id": one.id, "picture": one.view, **_full(one)} for one in found.markers],
        "cameras": [{"picture": one.view, **_full(one)} for one in found.cameras],
        "joint_covariance": {
            "markers": found.frame.ids.tolist(),
            "cameras": [camera.view for camera in found.cameras],
            "values": (found.variance_factor * found.frame.covariance).tolist(),
        },
    }


def _full(pose: MarkerPose | CameraPose) -> dict[str, list[Array]]:
    return {
        "rotation": pose.rotation.tolist(),
        "position_m": pose.position_m.tolist(),
        "covariance": pose.covariance.tolist(),
    }
