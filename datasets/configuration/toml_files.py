"""TOML files that users write: read from a file or built in, and refused in one line where they are wrong."""

import tomllib
from copy import deepcopy
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from skyherd.errors import InputError


def built_in_names(package: str) -> list[str]:
    """Names of the TOML files in a package, without their suffix, in alphabetical order."""
    return sorted(
        entry.name.removesuffix(".toml") for entry in files(package).iterdir() if entry.name.endswith(".toml")
    )


def built_in_text(package: str, name: str, noun: str) -> str:
    """TOML text of a built-in file.

    Args:
        package: the package in which they lie.
        name: of the file, without its suffix.
        noun: what such a file is called in the complaint.

    Raises:
        InputError: there is none of that name; the error lists those that there are.
    """
    names = built_in_names(package)
    if name not in names:
        raise InputError(
            f"{noun} {name!r}",
            "no such file, nor a built-in of that name",
            f"a TOML file or one of {', '.join(names)}",
        )
    return files(package).joinpath(f"{name}.toml").read_text("utf-8")


def read_text(path: Path, noun: str) -> str:
    """Text of a file; `noun` is what it is called in the complaint.

    Raises:
        InputError: it cannot be read, or is no text.
    """
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError:
        raise InputError(str(path), "not a text file", f"a {noun} in TOML, UTF-8") from None
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), f"a readable {noun} in TOML") from None


def parse_toml(text: str, where: str, example: str) -> dict[str, Any]:
    """Parse a TOML text into dictionaries, lists and plain values.

    Args:
        text: the TOML text.
        where: what to call it in the complaint.
        example: the command that shows a good one.

    Raises:
        InputError: it is no TOML.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"malformed TOML: {error}", f"see `{example}` for a good one") from None


def put_value(tree: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Put a value at a dotted key such as `units.0.height_m`, where `*` is every item of a list.

    Raises:
        InputError: the key leads nowhere.
    """
    *parents, last = key.strip().split(".")
    nodes: list[Any] = [tree]
    for part in parents:
        nodes = [child for node in nodes for child in _children(node, part, where)]
    for node in nodes:
        for place in [last] if isinstance(node, dict) else _indices(node, last, where):
            node[place] = deepcopy(value)


def get_value(tree: dict[str, Any], key: str) -> Any:
    """The value at a dotted key of a complete tree, where `*` is the first item of a list."""
    node: Any = tree
    for part in key.split("."):
        node = node[part] if isinstance(node, dict) else node[0 if part == "*" else int(part)]
    return node


def _children(node: Any, part: str, where: str) -> list[Any]:
    if isinstance(node, dict):
        return [node.setdefault(part, {})]
    return [node[index] for index in _indices(node, part, where)]


def _indices(node: Any, part: str, where: str) -> list[int]:
    """Which items of a list a part of a key means."""
    if isinstance(node, list):
        if part == "*":
            return list(range(len(node)))
        if part.isascii() and part.isdecimal() and int(part) < len(node):
            return [int(part)]
    allowed = f"0 to {len(node) - 1}, or *" if isinstance(node, list) else "see `skyherd scenario schema`"
    raise InputError(where, f"nothing there called {part!r}", allowed)


def first_error(error: ValidationError, where: str, noun: str, *, see: str | None = None) -> InputError:
    """Turn the first complaint of a validation into an error of one line.

    Args:
        error: what Pydantic raised.
        where: the file, or what to call it.
        noun: the verb of the command line whose `schema` shows what is allowed.
        see: another command to name in place of `skyherd NOUN schema`.
    """
    first, *others = error.errors()
    key = ".".join(str(part) for part in first["loc"]) or noun
    value = first["input"]
    shown = (
        ""
        if isinstance(value, dict | list) and first["type"] != "extra_forbidden"
        else f" (given: {value!r})"
    )
    allowed = f"{first['msg']}{shown}"
    more = f" — and {len(others)} more" if others else ""
    what = {"missing": "missing", "extra_forbidden": "unknown key"}.get(first["type"], "wrong value")
    return InputError(f"{where}: {key}", what, f"{allowed}{more}; see `{see or f'skyherd {noun} schema'}`")
