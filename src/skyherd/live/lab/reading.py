"""Lab files read, changed by settings, and checked."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from skyherd.control import Template
from skyherd.datasets import (
    built_in_names,
    built_in_text,
    first_error,
    parse_toml,
    put_value,
    read_toml_text,
    shape_points,
)
from skyherd.errors import DegenerateSetError, InputError
from skyherd.files.reading import is_regular
from skyherd.geometry import ComplexArray, to_complex
from skyherd.live.lab.checks import check_drivers, check_model
from skyherd.live.lab.models import LabModel
from skyherd.live.lab.set_up import Lab
from skyherd.messages.checks import check_texts

LABS = "skyherd.live.labs"
"""Package of the examples that `skyherd live show` prints."""


def lab_names() -> list[str]:
    """Names of the examples."""
    return built_in_names(LABS)


def lab_text(name: str) -> str:
    """TOML text of an example.

    Raises:
        InputError: there is none of that name.
    """
    return built_in_text(LABS, name, "lab")


def load_lab(name_or_file: str, settings: Iterable[str] = ()) -> Lab:
    """Read and check a lab file, or an example by its name.

    Args:
        name_or_file: a TOML file, or the name of an example.
        settings: `key=value` texts put over it, such as `limits.max_speed_mps=0.1`.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    path = Path(name_or_file)
    is_file = path.suffix == ".toml" or is_regular(path)
    text = read_toml_text(path, "lab") if is_file else lab_text(name_or_file)
    where = str(path) if is_file else f"lab {name_or_file}"
    tree = parse_toml(text, where, "skyherd live show webcams")
    for setting in settings:
        check_texts("settings", [setting])
        key, sign, value = setting.partition("=")
        if not sign:
            raise InputError(f"--set {setting}", "no value", "key=value")
        try:
            put_value(tree, key, parse_toml(f"value = {value}", setting, "key=value")["value"], setting)
        except InputError:
            put_value(tree, key, value, setting)
    lab = make_lab(tree, where=where, folder=path.parent if is_file else Path())
    check_drivers(lab.model, where)
    return lab


def make_lab(tree: dict[str, Any], *, where: str = "lab", folder: Path | None = None) -> Lab:
    """Check a lab given as a tree of plain values.

    Raises:
        InputError: in one line, the key, the value, and what is allowed.
    """
    try:
        model = LabModel.model_validate(tree)
    except ValidationError as error:
        raise first_error(error, where, "lab", see="skyherd live schema") from None
    check_model(model, where)
    ids = [robot.id for robot in model.robots]
    points = _points(model, len(ids), where)
    try:
        template = Template(np.array(ids), points.conj())
    except DegenerateSetError as error:
        raise InputError(f"{where}: shape", str(error), "at least two distinct points") from None
    return Lab(model, template, folder or Path())


def _points(model: LabModel, count: int, where: str) -> ComplexArray:
    """The shape's points (N,), x + iy, in map sense, in the order of the file's robots."""
    if model.shape.points is not None:
        return np.array([complex(x, y) for x, y in model.shape.points])
    try:
        return to_complex(shape_points(str(model.shape.shape), count))
    except InputError as error:  # which names the key that scenarios have for it
        raise InputError(f"{where}: shape.shape", error.what, error.allowed) from None
