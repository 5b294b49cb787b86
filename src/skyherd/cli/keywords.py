"""Parameters of the library in messages, as the options by which a user of the command line gives them.

The library names its parameters: as the place of an error, such as `jobs`, and in texts as a keyword in
backticks, such as `` `force=True` ``. `skyherd.cli.console` translates both where messages are printed.
"""

import os
import re

from skyherd.errors import InputError, SkyherdError

OPTIONS = {
    "border_bits": "--border-bits",
    "calibration": "--camera",
    "calibrations": "--camera",
    "cameras": "--cameras",
    "detector": "--detector",
    "dictionary": "--dictionary",
    "duration_s": "--duration",
    "fixed": "--fixed",
    "folder": "--out",
    "force": "--force",
    "host": "--host",
    "html": "--html",
    "ids": "--ids",
    "insecure": "--insecure",
    "inverted": "--inverted",
    "jobs": "--jobs",
    "kind": "--format",
    "offset_s": "--clock-offset",
    "only": "--only",
    "paper": "--paper",
    "path": "--out",
    "port": "--port",
    "reference": "--reference",
    "repeats": "--repeats",
    "retry": "--retry",
    "scheduler": "--scheduler",
    "seed": "--seed",
    "settings": "--set",
    "shape": "--shape",
    "side": "--side",
    "side_m": "--marker-side-m",
    "to": "--to",
    "topic": "--topic",
}
"""Options by the parameters of the library that messages name."""

_KEYWORD = re.compile(r"`(\w+)=([^`]*)`")
_PLACE = re.compile(r"(\w+): ")
_SETTING = re.compile(r"settings: [\w.*-]+: ")


def with_options(text: str) -> str:
    """Return a text with the keywords in backticks as options, such as --force for `` `force=True` ``."""
    return _KEYWORD.sub(_option, text)


def error_lines(error: SkyherdError) -> list[str]:
    """Return the lines of an error, with options in place of the library's parameters."""
    if isinstance(error, InputError):
        return [with_options(_placed(line)) for line in error.lines]
    return [with_options(str(error))]


def _placed(line: str) -> str:
    """Return the line of a problem with an option as its place, if its place was a parameter."""
    found = _PLACE.match(line)
    # A file may have the name of a parameter.
    if found is None or found[1] not in OPTIONS or os.path.lexists(found[1]):
        return line
    end = " " if found[1] == "settings" and _SETTING.match(line) else ": "
    return f"{OPTIONS[found[1]]}{end}{line[found.end() :]}"


def _option(found: re.Match[str]) -> str:
    name, value = OPTIONS.get(found[1]), found[2]
    if name is None:
        return found[0]
    if value in ("", "True"):
        return name
    return f"without {name}" if value == "False" else f"{name} {value}"
