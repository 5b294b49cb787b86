"""Reading and validation of lab files, with settings from the command line."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.control import Template
from skyherd.datasets import (
    LAB,
    apply_settings,
    built_in_names,
    check_tree,
    locate,
    read_source,
    shape_points,
    source_text,
)
from skyherd.errors import InputError, ProblemCollector
from skyherd.geometry import to_complex
from skyherd.live.lab.checks import check_drivers, check_model
from skyherd.live.lab.models import LabModel
from skyherd.live.lab.set_up import Lab


def lab_names() -> list[str]:
    """Return the names of the built-in labs."""
    return built_in_names(LAB.package)


def lab_text(name: str) -> str:
    """Return the TOML text of a built-in lab.

    Raises:
        InputError: no built-in lab has this name.
    """
    return source_text(name, LAB)


def load_lab(name_or_file: str, settings: Iterable[str] = ()) -> Lab:
    """Read and check a lab file or a built-in lab.

    Args:
        name_or_file: a TOML file, or the name of a built-in lab.
        settings: `key=value` texts that override the file, such as `limits.max_speed_mps=0.1`.

    Raises:
        InputError: one line per problem: the file or option, the key, the value, and the allowed values.
    """
    source = read_source(name_or_file, LAB)
    origins = apply_settings(source.tree, settings, "control.k=0.2", LAB.schema)
    return make_lab(source.tree, where=source.where, folder=source.folder, origins=origins, drivers=True)


def make_lab(
    tree: dict[str, Any],
    *,
    where: str = "lab",
    folder: Path | None = None,
    origins: Mapping[str, str] | None = None,
    drivers: bool = False,
) -> Lab:
    """Return the checked lab of a tree of plain values.

    Args:
        tree: dictionaries, lists and plain values, as in a TOML file.
        where: name of the lab in error messages.
        folder: folder to which file names are relative; the working folder if None.
        origins: options that set values, by dotted key, for error messages.
        drivers: True to check the addresses of the drivers too.

    Raises:
        InputError: one line per problem: the key, the value, and the allowed values.
    """
    origins = origins or {}
    model = check_tree(LabModel, tree, where, see=LAB.schema, origins=origins)
    problems = ProblemCollector()
    with problems.collecting():
        check_model(model, where, origins)
    if drivers:
        with problems.collecting():
            check_drivers(model, where, origins=origins)
    template = None
    with problems.collecting():
        template = _template(model, where, origins)
    problems.raise_all()
    if template is None:
        raise ValueError("a lab without problems has a shape")
    return Lab(model, template, folder or Path())


def _template(model: LabModel, where: str, origins: Mapping[str, str]) -> Template | None:
    """Return the shape with points in map orientation, or None if `check_model` refuses it."""
    ids, points = [robot.id for robot in model.robots], model.shape.points
    if len(set(ids)) < len(ids) or (model.shape.shape is None) == (points is None):
        return None
    if points is not None and len(points) != len(ids):
        return None
    try:
        if points is not None:
            return Template(np.array(ids), np.array([complex(x, y) for x, y in points]).conj())
        return Template(np.array(ids), to_complex(shape_points(str(model.shape.shape), len(ids))).conj())
    except InputError as error:  # The error names the key of scenarios; labs have another.
        key = "shape.shape" if points is None else "shape.points"
        raise InputError(locate(where, key, origins), error.what, error.allowed) from None
