"""Kinds of TOML files that users write, and their recognition in order to name a file of the wrong kind.

The top-level keys are literals, because most of the models belong to higher layers. A test compares them.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyherd.datasets.configuration.toml_files import (
    built_in_names,
    built_in_text,
    parse_toml,
    read_toml_text,
)
from skyherd.errors import InputError
from skyherd.files.reading import is_regular, open_regular

MCAP_MAGIC = b"\x89MCAP0\r\n"
"""First bytes of a recording. Defined by the MCAP format."""

RECORDING_SUFFIX = ".mcap"
"""Suffix of a recording's file name."""

MIN_KNOWN_SHARE = 0.8
"""Minimum share of a file's top-level keys that its kind has. Chosen: a mistyped key in five still passes."""

MIN_REQUIRED_SHARE = 0.5
"""Minimum share of a kind's required keys that a file has. Chosen: it recognizes incomplete files, too."""


@dataclass(frozen=True)
class FileKind:
    """Kind of file.

    Attributes:
        name: noun phrase for such a file.
        package: package of the built-in files.
        example: command that shows a valid file.
        schema: command that shows the allowed keys and values.
        taken_by: verbs that accept such a file.
        required: its required top-level keys.
        optional: its other top-level keys.
    """

    name: str
    package: str
    example: str
    schema: str
    taken_by: str
    required: frozenset[str]
    optional: frozenset[str]

    @property
    def noun(self) -> str:
        """First word of `name`, which precedes the name of a built-in file in messages."""
        return self.name.split()[0]

    def known_share(self, tree: dict[str, Any]) -> float:
        """Return the share of a file's top-level keys that this kind has."""
        return len(tree.keys() & (self.required | self.optional)) / max(len(tree), 1)

    def required_share(self, tree: dict[str, Any]) -> float:
        """Return the share of this kind's required keys that a file has."""
        return len(tree.keys() & self.required) / len(self.required)


def _keys(names: str) -> frozenset[str]:
    return frozenset(names.split())


SCENARIO = FileKind(
    "scenario",
    "skyherd.datasets.scenarios",
    "skyherd scenario show star",
    "skyherd scenario schema",
    "`skyherd run` or `skyherd scenario check`",
    _keys("name duration_s template robots marker units"),
    _keys(
        "description seed step_s perception detector control selection roles size avoidance autopilot "
        "network sensor ground occluders obstacles goal video interventions"
    ),
)

LAB = FileKind(
    "lab",
    "skyherd.live.labs",
    "skyherd live show webcams",
    "skyherd live schema",
    "`skyherd live run` or `skyherd live check`",
    _keys("team shape markers cameras robots"),
    _keys("control selection limits avoidance obstacles drive radio recording"),
)

STUDY = FileKind(
    "study",
    "skyherd.study.specs",
    "skyherd study noise --show",
    "skyherd study --schema",
    "`skyherd study`",
    _keys("scenario keep"),
    _keys("description set grid random sweeps tasks_version tasks figures pages quick"),
)

DATASET = FileKind(
    "dataset spec",
    "skyherd.datasets.specs",
    "skyherd dataset show small",
    "skyherd dataset schema",
    "`skyherd dataset make`",
    _keys("images"),
    _keys("description seed size_px validation cameras markers camera sensor ground occluders"),
)

KINDS = (SCENARIO, LAB, STUDY, DATASET)
"""All kinds."""


@dataclass(frozen=True)
class TomlSource:
    """Content of a file before validation.

    Attributes:
        tree: dictionaries, lists and plain values.
        where: name of the file in error messages.
        folder: base folder of relative paths in the file.
        is_file: True for a file of the user, False for a built-in file.
    """

    tree: dict[str, Any]
    where: str
    folder: Path
    is_file: bool


def read_source(name_or_file: str, kind: FileKind) -> TomlSource:
    """Read a built-in file or a TOML file, and check only its kind.

    Raises:
        InputError: the file does not exist, is not valid TOML, or is of another kind.
    """
    path = Path(name_or_file)
    is_file = path.suffix == ".toml" or is_regular(path)
    where = str(path) if is_file else f"{kind.noun} {name_or_file}"
    _refuse_recording(path, kind.name)
    text = read_toml_text(path, kind.name) if is_file else source_text(name_or_file, kind)
    tree = parse_toml(text, where, kind.example)
    refuse_other_kind(tree, where, kind)
    return TomlSource(tree, where, path.parent if is_file else Path(), is_file)


def source_text(name: str, kind: FileKind) -> str:
    """Return the TOML text of a built-in file.

    Raises:
        InputError: no built-in file of this kind has that name. If another kind has it, the error says so.
    """
    if name not in built_in_names(kind.package):
        for other in KINDS:
            if name in built_in_names(other.package):
                raise _of_another_kind(repr(name), other, kind.name)
    return built_in_text(kind.package, name, kind.noun)


def refuse_other_kind(tree: dict[str, Any], where: str, wanted: FileKind | str) -> None:
    """Raise an error if a file is recognized as one of another kind.

    Args:
        tree: the file's content.
        where: name of the file in error messages.
        wanted: the expected kind, or a noun phrase for one that is not in `KINDS`.

    Raises:
        InputError: the file is of another kind; the message names the verbs that accept it.
    """
    found = recognize(tree)
    if found is None or found is wanted:
        return
    if isinstance(wanted, str):
        raise _of_another_kind(where, found, wanted)
    if wanted.known_share(tree) < 1:
        raise _of_another_kind(where, found, wanted.name)


def recognize(tree: dict[str, Any]) -> FileKind | None:
    """Return the kind of a file, recognized by its top-level keys, or None."""
    best = max(KINDS, key=lambda kind: (kind.known_share(tree), kind.required_share(tree)))
    is_known = best.known_share(tree) >= MIN_KNOWN_SHARE and best.required_share(tree) >= MIN_REQUIRED_SHARE
    return best if is_known else None


def refuse_configuration(path: Path, wanted: str) -> None:
    """Raise an error if a path is a recording or a configuration file, and name the verbs that accept it.

    Args:
        path: the given path; an unreadable file, or one of unknown kind, passes.
        wanted: noun for the expected input.

    Raises:
        InputError: it is a scenario, a lab, a study, a dataset spec, a recording or the folder of a run.
    """
    _refuse_recording(path, wanted)
    if path.suffix != ".toml" or not is_regular(path):
        return
    try:
        found = recognize(parse_toml(read_toml_text(path, "file"), str(path), ""))
    except InputError:
        return
    if found is not None:
        raise _of_another_kind(str(path), found, wanted)


def is_recording(path: Path) -> bool:
    """Return True if a file is a recording, by its first bytes or its suffix."""
    if not is_regular(path):
        return path.suffix == RECORDING_SUFFIX
    try:
        with open_regular(path, "a file") as stream:
            return stream.read(len(MCAP_MAGIC)) == MCAP_MAGIC or path.suffix == RECORDING_SUFFIX
    except (InputError, OSError):
        return path.suffix == RECORDING_SUFFIX


def _refuse_recording(path: Path, wanted: str) -> None:
    if is_regular(path) and is_recording(path):
        what = f"is a recording, not a {wanted}"
    elif os.path.isdir(path) and is_regular(path / f"run{RECORDING_SUFFIX}"):
        what = f"is the folder of a run, not a {wanted}"
    else:
        return
    raise InputError(str(path), what, "give it to `skyherd topology`, or its folder to `skyherd report`")


def _of_another_kind(where: str, found: FileKind, wanted: str) -> InputError:
    return InputError(where, f"is a {found.name}, not a {wanted}", f"give it to {found.taken_by}")
