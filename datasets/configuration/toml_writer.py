"""Text of a tree of plain values in TOML, the inverse of `parse_toml`."""

import json
import re
from collections.abc import Mapping
from typing import Any

from skyherd.messages.checks import check_kind

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(tree: Mapping[str, Any]) -> str:
    """Return a tree as TOML, one key on each line.

    Tables of the top level have headers; lists of tables there have a header for each item. Deeper tables are
    inline. Values of None are left out, since TOML has no such value.

    Args:
        tree: dictionaries, lists, tuples, texts, numbers and booleans.

    Raises:
        InputError: it is not a mapping.
    """
    check_kind("toml_text: tree", tree, Mapping, "a mapping")
    plain, tables = [], []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            tables.append(f"\n[{_key(key)}]\n{_lines(value)}")
        elif isinstance(value, list | tuple) and value and all(isinstance(one, Mapping) for one in value):
            tables += [f"\n[[{_key(key)}]]\n{_lines(one)}" for one in value]
        elif value is not None:
            plain.append(f"{_key(key)} = {_inline(value)}\n")
    return "".join([*plain, *tables])


def _lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{_key(key)} = {_inline(value)}\n" for key, value in table.items() if value is not None)


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    # JSON escapes what TOML does, except the control character DEL.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline(value: Any) -> str:
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return _quoted(value)
        case int() | float():
            return repr(value)
        case Mapping():
            pairs = (f"{_key(key)} = {_inline(one)}" for key, one in value.items() if one is not None)
            return f"{{ {', '.join(pairs)} }}"
        case _:
            return f"[{', '.join(map(_inline, value))}]"
