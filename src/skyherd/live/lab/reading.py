"""Lab files read, changed by settings, and checked."""

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
from skyherd.errors import DegenerateSetError, InputError, ProblemCollector
from skyherd.geometry import to_complex
from skyherd.live.lab.checks import check_drivers, check_model
from skyherd.live.lab.models import LabModel
from skyherd.live.lab.set_up import Lab


def lab_names() -> list[str]:
    """Names of the examples."""
    return built_in_names(LAB.package)


def lab_text(name: str) -> str:
    """TOML text of an example.

    Raises:
        InputError: no example has that name.
    """
    return source_text(name, LAB)


def load_lab(name_or_file: str, settings: Iterable[str] = ()) -> Lab:
    """Read and check a lab file, or an example by its name.

    Args:
        name_or_file: a TOML file, or the name of an example.
        settings: `key=value` texts put over it, such as `limits.max_speed_mps=0.1`.

    Raises:
        InputError: a line for each problem: the file or the option, the key, the value, and what is allowed.
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
    """Check a lab given as a tree of plain values.

    Args:
        tree: dictionaries, lists and plain values, as in a TOML file.
        where: what to call it in a problem.
        folder: the folder to which files are relative; the working folder if None.
        origins: options that gave values, by dotted key, to name them as the places of problems.
        drivers: whether to check the addresses of the drivers, too.

    Raises:
        InputError: a line for each problem: the key, the value, and what is allowed.
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
    """Return the shape, its points in map sense; None if `check_model` refuses it."""
    ids, points = [robot.id for robot in model.robots], model.shape.points
    if len(set(ids)) < len(ids) or (model.shape.shape is None) == (points is None):
        return None
    if points is not None and len(points) != len(ids):
        return None
    try:
        if points is not None:
            return Template(np.array(ids), np.array([complex(x, y) for x, y in points]).conj())
        return Template(np.array(ids), to_complex(shape_points(str(model.shape.shape), len(ids))).conj())
    except InputError as error:  # which names the key that scenarios have for it
        key = "shape.shape" if points is None else "shape.points"
        raise InputError(locate(where, key, origins), error.what, error.allowed) from None
    except DegenerateSetError as error:
        raise InputError(
            locate(where, "shape", origins), str(error), "at least two distinct points"
        ) from None
