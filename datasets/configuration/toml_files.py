"""TOML files of users: reading from a file or a package, parsing, and changes of single keys."""

import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from copy import deepcopy
from importlib.resources import files
from pathlib import Path
from typing import Any

from skyherd.datasets.configuration.validation import MAX_SHOWN
from skyherd.errors import InputError
from skyherd.files.reading import read_text
from skyherd.messages.checks import check_kind, check_texts
from skyherd.text import did_you_mean, shorten

MAX_BYTES = 2**18
"""Maximum size of a TOML file, bytes. Chosen: positions of a thousand robots, one per line, take a fifth of
it; it is parsed in about a second."""

MAX_LEVELS = 32
"""Maximum depth of tables and lists in a TOML file. Chosen: scenarios have six levels."""

_STRINGS = re.compile(
    r"\"{3}(?:\\.|[^\\])*?\"{3}|'{3}.*?'{3}|\"(?:\\.|[^\"\\\n])*\"|'[^'\n]*'|#[^\n]*", re.DOTALL
)
_BRACKETS, _BETWEEN_KEYS = re.compile(r"[\[\]{}]"), re.compile(r"[^\w.-]+")


def built_in_names(package: str) -> list[str]:
    """Return the names of the TOML files in a package, without suffix, in alphabetical order."""
    check_kind("built_in_names: package", package, str, "a name")
    return sorted(
        entry.name.removesuffix(".toml") for entry in files(package).iterdir() if entry.name.endswith(".toml")
    )


def built_in_text(package: str, name: str, noun: str) -> str:
    """Return the TOML text of a built-in file.

    Args:
        package: package of the files.
        name: name of the file, without its suffix.
        noun: noun for such a file in error messages.

    Raises:
        InputError: no file has that name; the error lists the names.
    """
    check_kind(noun, name, (str, Path), "a name or a file")
    name = str(name)
    names = built_in_names(package)
    if name not in names:
        meant = did_you_mean(name, names)
        raise InputError(
            f"{noun} {name!r}",
            "is a folder" if os.path.isdir(name) else "no such file, nor a built-in of that name",
            f"{meant} " * bool(meant) + f"a TOML file or one of {', '.join(names)}",
        )
    return files(package).joinpath(f"{name}.toml").read_text("utf-8")


def read_toml_text(path: Path, noun: str) -> str:
    """Return the text of a TOML file; `noun` names it in error messages.

    Raises:
        InputError: it cannot be read, is larger than `MAX_BYTES`, or is not text.
    """
    return read_text(path, f"a readable {noun} in TOML, UTF-8", MAX_BYTES)


def parse_toml(text: str, where: str, example: str) -> dict[str, Any]:
    """Parse a TOML text into dictionaries, lists and plain values.

    Args:
        text: the TOML text.
        where: name of the text in error messages.
        example: command that shows a valid file.

    Raises:
        InputError: it is not valid TOML, or nested more deeply than `MAX_LEVELS`.
    """
    if depth(text) > MAX_LEVELS:
        raise InputError(where, f"nested more than {MAX_LEVELS} deep", f"see `{example}` for a good one")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # integers of very many digits raise a plain ValueError
        raise InputError(where, f"malformed TOML: {error}", f"see `{example}` for a good one") from None


def depth(text: str) -> int:
    """Return an upper bound of the depth of a TOML text: of nested brackets, or of names in a dotted key.

    It protects the parser. The parser's stack grows with the depth of brackets, and its time with the square
    of the number of names in a key. The result is also defined for texts that are not valid TOML.
    """
    plain = _STRINGS.sub(lambda found: "" if found[0].startswith("#") else "s", text)
    level = deepest = 0
    for bracket in _BRACKETS.findall(plain):
        level += 1 if bracket in "[{" else -1
        deepest = max(deepest, level)
    keys = _BETWEEN_KEYS.split(plain.replace(" ", "").replace("\t", ""))
    return max(deepest, 1 + max(key.count(".") for key in keys))


def apply_settings(
    tree: dict[str, Any], settings: Iterable[str] | Mapping[str, object], example: str, see: str
) -> dict[str, str]:
    """Apply settings such as `units.*.height_m=9` to a tree; a value is TOML, or plain text if it is not.

    Args:
        tree: the tree, which is modified.
        settings: `KEY=VALUE` texts, or values by dotted key.
        example: a valid setting, for error messages.
        see: command that shows all keys.

    Returns:
        `settings: KEY` by key, with which later errors name the setting.

    Raises:
        InputError: a setting has no key or no value, or its key does not exist.
    """
    origins = {}
    if isinstance(settings, Mapping):
        for key, value in settings.items():
            put_value(tree, key, value, f"settings: {key}", see=see)
            origins[key] = f"settings: {key}"
        return origins
    for setting in check_texts("settings", settings):
        key, equals, text = setting.partition("=")
        if not equals or not key.strip():
            what = f"{shorten(setting, MAX_SHOWN)!r} is not of the form KEY=VALUE"
            raise InputError("settings", what, f"such as {example}")
        key = key.strip()
        put_value(tree, key, _setting_value(text), f"settings: {key}", see=see)
        origins[key] = f"settings: {key}"
    return origins


def _setting_value(text: str) -> Any:
    try:
        parsed = parse_toml(f"value = {text}", "settings", "")
    except InputError:
        return text
    return parsed["value"] if len(parsed) == 1 else text


def put_value(
    tree: dict[str, Any], key: str, value: Any, where: str, *, see: str = "skyherd scenario schema"
) -> None:
    """Set the value at a dotted key such as `units.0.height_m`, where `*` is every item of a list.

    Args:
        tree: the tree, which is modified.
        key: the dotted key.
        value: the value, which is copied.
        where: name of the key in error messages.
        see: command that shows all keys.

    Raises:
        InputError: the key does not lead to a table or an item.
    """
    check_kind(f"{where}: key", key, str, "a dotted key")
    *parents, last = key.strip().split(".")
    if len(parents) >= MAX_LEVELS:
        raise InputError(where, f"more than {MAX_LEVELS} names", f"see `{see}`")
    nodes: list[Any] = [tree]
    for part in parents:
        nodes = [child for node in nodes for child in _children(node, part, where, see)]
    for node in nodes:
        for place in [last] if isinstance(node, dict) else _indices(node, last, where, see):
            node[place] = deepcopy(value)


def get_value(tree: dict[str, Any], key: str) -> Any:
    """Return the value at a dotted key of a complete tree, where `*` is the first item of a list."""
    check_kind("get_value: key", key, str, "a dotted key")
    node: Any = tree
    for part in key.split("."):
        node = node[part] if isinstance(node, dict) else node[0 if part == "*" else int(part)]
    return node


def _children(node: Any, part: str, where: str, see: str) -> list[Any]:
    if isinstance(node, dict):
        return [node.setdefault(part, {})]
    return [node[index] for index in _indices(node, part, where, see)]


def _indices(node: Any, part: str, where: str, see: str) -> list[int]:
    """Return the indices of the items of a list that a part of a key selects."""
    if not isinstance(node, list):
        raise InputError(
            where, f"nothing is called {part!r} there", f"the part before it is not a table; see `{see}`"
        )
    if part == "*":
        return list(range(len(node)))
    if part.isascii() and part.isdecimal() and len(part) < MAX_SHOWN and int(part) < len(node):
        return [int(part)]
    raise InputError(
        where, f"no item {part!r} in the list", f"0 to {len(node) - 1}, or *" if node else "the list is empty"
    )
