"""A single output file of a verb, under the rules of output folders."""

import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from skyherd.errors import InputError
from skyherd.files.output_folder import OutputFolder, check_name

WAIT_S = 2.0
"""Time to wait for a folder in use by another process, s. *Chosen*: longer than any single file takes, and
short for a person."""


class OutputFile:
    """A single file written by a verb inside a `with` body, under the rules of `OutputFolder`.

    Args:
        path: the file; its folder must exist.
        verb: the writing verb.
        force: accept an existing file, if the verb made it.
        inputs: files that are read, none of which may be replaced.
        parameter: name of the parameter that names the file.

    Entering raises InputError as `check` does, or if another process keeps the folder in use.
    """

    def __init__(
        self,
        path: Path,
        verb: str,
        *,
        force: bool = False,
        inputs: Sequence[Path] = (),
        parameter: str = "path",
    ) -> None:
        self.path, self._force, self._parameter = path, force, parameter
        self._folder = OutputFolder(path.parent, verb, [path.name], resume=True, inputs=inputs, wait_s=WAIT_S)

    def check(self) -> None:
        """Reject a file that must not be written; change nothing.

        Raises:
            InputError: its folder does not exist, it exists without `force`, or another maker wrote it.
        """
        check_name(self.path)
        if not self.path.parent.is_dir():
            raise InputError(str(self.path), f"no folder {self.path.parent}", "make it first")
        if os.path.lexists(self.path) and not self._force:
            allowed = f"choose another `{self._parameter}=`, or replace it with `force=True`"
            raise InputError(str(self.path), "exists", allowed)
        self._folder.check()

    def __enter__(self) -> Self:
        self.check()
        self._folder.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._folder.__exit__(kind, error, trace)
