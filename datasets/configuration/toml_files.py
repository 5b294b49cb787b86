"""TOML files that users write: read from a file or built in, and refused in one line where they are wrong."""

import os
import re
import tomllib
from copy import deepcopy
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from skyherd.errors import InputError
from skyherd.files.reading import read_text
from skyherd.messages.checks import check_kind
from skyherd.text import shorten

MAX_BYTES = 2**18
"""Size of the largest TOML file that is read. *Chosen*: places of a thousand robots, each with its own line,
take a fifth of it; it is parsed in about a second."""

MAX_LEVELS = 32
"""Levels of tables and lists in a TOML file. *Chosen*: scenarios have six."""

MAX_SHOWN = 60
"""Characters of a value that a complaint shows. *Chosen*: a number, a name or a short list."""

_STRINGS = re.compile(
    r"\"{3}(?:\\.|[^\\])*?\"{3}|'{3}.*?'{3}|\"(?:\\.|[^\"\\\n])*\"|'[^'\n]*'|#[^\n]*", re.DOTALL
)
_BRACKETS, _BETWEEN_KEYS = re.compile(r"[\[\]{}]"), re.compile(r"[^\w.-]+")


def built_in_names(package: str) -> list[str]:
    """Names of the TOML files in a package, without their suffix, in alphabetical order."""
    check_kind("built_in_names: package", package, str, "a name")
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
    check_kind(noun, name, (str, Path), "a name or a file")
    name = str(name)
    names = built_in_names(package)
    if name not in names:
        raise InputError(
            f"{noun} {name!r}",
            "is a folder" if os.path.isdir(name) else "no such file, nor a built-in of that name",
            f"a TOML file or one of {', '.join(names)}",
        )
    return files(package).joinpath(f"{name}.toml").read_text("utf-8")


def read_toml_text(path: Path, noun: str) -> str:
    """Text of a TOML file; `noun` is what it is called in the complaint.

    Raises:
        InputError: it cannot be read, is larger than `MAX_BYTES`, or is no text.
    """
    return read_text(path, f"a readable {noun} in TOML, UTF-8", MAX_BYTES)


def parse_toml(text: str, where: str, example: str) -> dict[str, Any]:
    """Parse a TOML text into dictionaries, lists and plain values.

    Args:
        text: the TOML text.
        where: what to call it in the complaint.
        example: the command that shows a good one.

    Raises:
        InputError: it is no TOML, or nested more deeply than `MAX_LEVELS`.
    """
    if depth(text) > MAX_LEVELS:
        raise InputError(where, f"nested more than {MAX_LEVELS} deep", f"see `{example}` for a good one")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # integers of very many digits are no TOMLDecodeError
        raise InputError(where, f"malformed TOML: {error}", f"see `{example}` for a good one") from None


def depth(text: str) -> int:
    """Levels of a TOML text, at most: of brackets within each other, or of names in a dotted key.

    Looked at before the text is parsed, since the parser takes the stack for each level of brackets, and time
    in proportion to the square of the names in a key. A text that is no TOML has some number, too.
    """
    plain = _STRINGS.sub(lambda found: "" if found[0].startswith("#") else "s", text)
    level = deepest = 0
    for bracket in _BRACKETS.findall(plain):
        level += 1 if bracket in "[{" else -1
        deepest = max(deepest, level)
    keys = _BETWEEN_KEYS.split(plain.replace(" ", "").replace("\t", ""))
    return max(deepest, 1 + max(key.count(".") for key in keys))


def put_value(tree: dict[str, Any], key: str, value: Any, where: str) -> None:
    """Put a value at a dotted key such as `units.0.height_m`, where `*` is every item of a list.

    Raises:
        InputError: the key leads nowhere.
    """
    check_kind(f"{where}: key", key, str, "a dotted key")
    *parents, last = key.strip().split(".")
    if len(parents) >= MAX_LEVELS:
        raise InputError(where, f"more than {MAX_LEVELS} names", "see `skyherd scenario schema`")
    nodes: list[Any] = [tree]
    for part in parents:
        nodes = [child for node in nodes for child in _children(node, part, where)]
    for node in nodes:
        for place in [last] if isinstance(node, dict) else _indices(node, last, where):
            node[place] = deepcopy(value)


def get_value(tree: dict[str, Any], key: str) -> Any:
    """The value at a dotted key of a complete tree, where `*` is the first item of a list."""
    check_kind("get_value: key", key, str, "a dotted key")
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
        if part.isascii() and part.isdecimal() and len(part) < MAX_SHOWN and int(part) < len(node):
            return [int(part)]
    allowed = f"0 to {len(node) - 1}, or *" if isinstance(node, list) else "see `skyherd scenario schema`"
    raise InputError(where, f"nothing there called {part!r}", allowed)


def _shown(value: Any) -> str:
    """A value in a complaint, shortened."""
    try:
        return shorten(repr(value), MAX_SHOWN)
    except ValueError:
        return "an integer of very many digits"


def first_error(error: ValidationError, where: str, noun: str, *, see: str | None = None) -> InputError:
    """Turn the first complaint of a validation into an error of one line.

    Args:
        error: what Pydantic raised.
        where: the file, or what to call it.
        noun: the verb of the command line whose `schema` shows what is allowed.
        see: another command to name in place of `skyherd NOUN schema`.
    """
    check_kind("first_error: error", error, ValidationError, "a pydantic.ValidationError")
    first, *others = error.errors()
    key = shorten(".".join(str(part) for part in first["loc"]) or noun, MAX_SHOWN)
    value = first["input"]
    shown = (
        ""
        if isinstance(value, dict | list) and first["type"] != "extra_forbidden"
        else f" (given: {_shown(value)})"
    )
    allowed = f"{first['msg']}{shown}"
    more = f" — and {len(others)} more" if others else ""
    what = {"missing": "missing", "extra_forbidden": "unknown key"}.get(first["type"], "wrong value")
    return InputError(f"{where}: {key}", what, f"{allowed}{more}; see `{see or f'skyherd {noun} schema'}`")
