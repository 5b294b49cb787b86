"""What users write in TOML: read from a file or built in, and refused in one line where it is wrong."""

import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from skyherd.errors import InputError


def built_in_names(package: str) -> list[str]:
    """Names of the TOML files in a package."""
    return sorted(
        entry.name.removesuffix(".toml") for entry in files(package).iterdir() if entry.name.endswith(".toml")
    )


def built_in_text(package: str, name: str, noun: str) -> str:
    """TOML text of one of them; InputError names those there are."""
    names = built_in_names(package)
    if name not in names:
        raise InputError(
            f"{noun} {name!r}",
            "no such file, nor a built-in of that name",
            f"a TOML file or one of {', '.join(names)}",
        )
    return files(package).joinpath(f"{name}.toml").read_text("utf-8")


def read_text(path: Path, noun: str) -> str:
    """Text of a file; InputError if it is none or cannot be read."""
    try:
        return path.read_text("utf-8")
    except UnicodeDecodeError:
        raise InputError(str(path), "not a text file", f"a {noun} in TOML, UTF-8") from None
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), f"a readable {noun} in TOML") from None


def parse(text: str, where: str, example: str) -> dict[str, Any]:
    """The tree of a TOML text; `example` is the command that shows a good one."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"malformed TOML: {error}", f"see `{example}` for a good one") from None


def first_error(error: ValidationError, where: str, noun: str) -> InputError:
    """The first complaint as one line, and how many more there are."""
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
    return InputError(f"{where}: {key}", what, f"{allowed}{more}; see `skyherd {noun} schema`")
