"""Ownership of output folders: what may be written, and what `force` may replace.

An output folder has a record, `.skyherd.json`. It lists the files that skyherd made, the verb of each, and
its SHA-256. The rules for every verb follow from it:

- A file that is not in the record, or was changed since, is foreign. It is never replaced or removed.
- `force` removes files that the same verb made there before, and nothing else.
- Names are claimed in the record before they are written, so that remains of a killed process are known.
- A failed command removes its files and a new folder, unless it kept them for a later command.
- One process at a time writes into a folder. A lock enforces this and ends with the process.
"""

import os
import shutil
from collections.abc import Iterable, Sequence
from contextlib import suppress
from errno import EACCES
from pathlib import Path
from types import TracebackType
from typing import Self

from skyherd.errors import InputError, OutputError
from skyherd.files.atomic import PART, remove_part
from skyherd.files.folder_lock import FolderLock
from skyherd.files.folder_record import RECORD, Entry, digest_of, read_entries, write_record, writer_of
from skyherd.files.reading import is_regular

MAX_NAME_BYTES = 255
"""Bytes of the longest name of a file. *Defined* by Linux, macOS and Windows alike."""


class OutputFolder:
    """Context of a folder that a verb writes into: locked, recorded, and cleaned up after a failure.

    ```python
    with OutputFolder(Path("runs/star"), "run", ["run.mcap", "summary.json"], force=True) as output:
        ...  # write the files
    ```

    Args:
        path: the folder; created if missing.
        verb: the writing verb, as on the command line: `run`.
        names: files that will be written, relative to the folder. A name that ends in `/` is a folder that
            belongs to the verb entirely. A claimed name that is not written is dropped.
        force: accept an existing folder; files that the verb made there before are removed first.
        resume: accept an existing folder; files of the verb stay until they are written again.
        inputs: files that are read, none of which may be replaced.
        wait_s: how long to wait if another process writes into the folder.
        elsewhere: additional advice in error messages; None for a verb that only writes beside its input.

    Entering raises InputError before any change. Reasons are: the folder exists without `force` or `resume`,
    is a file, cannot be created, is in use by another process, or holds a foreign file of a claimed name.
    """

    def __init__(
        self,
        path: Path,
        verb: str,
        names: Iterable[str],
        *,
        force: bool = False,
        resume: bool = False,
        inputs: Sequence[Path] = (),
        wait_s: float = 0.0,
        elsewhere: str | None = "choose another `folder=`",
    ) -> None:
        self.path, self.verb, self.names = path, verb, list(names)
        self._force, self._resume, self._inputs, self._wait_s = force, resume, inputs, wait_s
        self._or_elsewhere = "" if elsewhere is None else f", or {elsewhere}"
        self._entries: dict[str, Entry] = {}
        self._made_folders: list[Path] = []
        self._new_names: set[str] = set()
        self._lock = FolderLock()
        self._kept = False

    def check(self) -> None:
        """Reject what entering would reject, as far as known now, and change nothing.

        Raises:
            InputError: as for entering.
        """
        check_name(self.path)
        if os.path.lexists(self.path) and not os.path.isdir(self.path):
            raise InputError(str(self.path), "is a file", "a folder to make; choose another `folder=`")
        if not os.path.lexists(self.path):
            return
        if not (self._force or self._resume):
            raise InputError(
                str(self.path), "exists", "choose another `folder=`, or write into it with `force=True`"
            )
        entries = read_entries(self.path)
        for name in self.names:
            self._check_free(name, entries)

    def keep(self) -> None:
        """Keep the results from now on if the body fails: a later command resumes from them."""
        self._kept = True

    def discard(self) -> None:
        """Revoke `keep`: the results are worthless."""
        self._kept = False

    def __enter__(self) -> Self:
        self.check()
        try:
            self._make_folders()
            if not self._lock.acquire(self.path, self._wait_s):
                self._made_folders = []  # the other one's now
                raise InputError(str(self.path), writer_of(self.path), f"wait for it{self._or_elsewhere}")
        except OSError as error:
            self._remove_made_folders()
            if isinstance(error, InputError | OutputError):
                raise
            what = error.strerror or str(error)
            allowed = f"make the folder writable{self._or_elsewhere}"
            raise InputError(str(self.path), what, allowed) from None
        try:
            self.check_claims()
            if self._force:
                self._remove_former()
            self._remove_parts()
            self._new_names = {name for name in self.names if not os.path.lexists(self.path / name)}
            self._entries |= {name: Entry(self.verb) for name in self.names}
            write_record(self.path, self._entries, writer=self.verb)
        except BaseException:
            self._lock.release()
            self._remove_made_folders()
            raise
        return self

    def check_claims(self) -> None:
        """Reread the record under the lock, and check every name against it."""
        self._entries = read_entries(self.path)
        for name in self.names:
            self._check_free(name, self._entries)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._remove_parts()
            if error is not None and not self._kept:
                self._undo()
            else:
                self._finish()
        except OSError:
            if error is None:
                raise
        finally:
            self._lock.release()
            if error is not None and not self._kept:
                self._remove_made_folders()

    def _check_free(self, name: str, entries: dict[str, Entry]) -> None:
        """Reject a name of an input, or of a file that this verb did not make."""
        path = self.path / name
        if not os.path.lexists(path):
            for parent in list(path.relative_to(self.path).parents)[:-1]:
                if os.path.lexists(self.path / parent) and not (self.path / parent).is_dir():
                    raise self._foreign(self.path / parent, "is in the way")
            return
        if any(_is_same(path, read) for read in self._inputs):
            raise InputError(str(path), "is an input, and would be replaced", "choose another `folder=`")
        entry = entries.get(name)
        if entry is None:
            raise self._foreign(path, "was not made by skyherd")
        if entry.maker != self.verb:
            raise self._foreign(path, f"was made by `skyherd {entry.maker}`")
        if name.endswith("/"):
            if path.is_symlink() or not path.is_dir():
                raise self._foreign(path, "was not made by skyherd")
        elif path.is_symlink() or not is_regular(path):
            raise self._foreign(path, "was not made by skyherd")
        elif entry.digest is not None and entry.digest != digest_of(path):
            raise self._foreign(path, "was changed since skyherd made it")

    def _foreign(self, path: Path, what: str) -> InputError:
        return InputError(str(path), what, f"move it away{self._or_elsewhere}")

    def _make_folders(self) -> None:
        """Create the folder and its parents; remember those that are new."""
        missing = [self.path, *self.path.parents]
        missing = missing[: next((k for k, folder in enumerate(missing) if folder.exists()), len(missing))]
        for folder in reversed(missing):
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            self._made_folders.insert(0, folder)
        if not os.access(self.path, os.W_OK | os.X_OK):
            raise PermissionError(EACCES, "Permission denied")

    def _remove_made_folders(self) -> None:
        for folder in self._made_folders:
            with suppress(OSError):
                folder.rmdir()

    def _remove_former(self) -> None:
        """Remove the verb's unchanged earlier files, and folders that are empty then."""
        folders: set[Path] = set()
        for name, entry in list(self._entries.items()):
            path = self.path / name
            if entry.maker != self.verb:
                continue
            if not name.endswith("/") and not path.is_symlink() and is_regular(path):
                if any(_is_same(path, read) for read in self._inputs):
                    continue
                if entry.digest in (None, digest_of(path)):
                    path.unlink()
                    folders |= set(path.relative_to(self.path).parents)
            del self._entries[name]
        for folder in sorted(folders, reverse=True):  # inner ones first
            with suppress(OSError):  # of a folder with other files, among them the record's own
                (self.path / folder).rmdir()

    def _remove_parts(self) -> None:
        """Remove incomplete files and folders of earlier processes."""
        folders = {(self.path / name).parent for name in [*self.names, *self._entries, RECORD]}
        for name in self.names:
            if name.endswith("/"):
                folders |= {self.path / name, *(p for p in (self.path / name).rglob("*") if p.is_dir())}
        for folder in folders:
            if folder.is_dir():
                for path in folder.iterdir():
                    if PART.fullmatch(path.name):
                        remove_part(path)

    def _undo(self) -> None:
        """Remove the new files, and drop them from the record."""
        for name in self._new_names:
            path = self.path / name
            self._entries.pop(name, None)
            if name.endswith("/"):
                shutil.rmtree(path, ignore_errors=True)
            else:
                with suppress(OSError):  # of a name that no file can have, nothing was made
                    path.unlink()
            for parent in list(path.relative_to(self.path).parents)[:-1]:
                with suppress(OSError):
                    (self.path / parent).rmdir()
        self._finish()

    def _finish(self) -> None:
        """Complete the record with the digest of each existing claimed file; write no empty record."""
        for name in self.names:
            path = self.path / name
            if not name.endswith("/") and is_regular(path):
                self._entries[name] = Entry(self.verb, digest_of(path))
        self._entries = {
            name: entry for name, entry in self._entries.items() if os.path.lexists(self.path / name)
        }
        if self._entries:
            write_record(self.path, self._entries)
        else:
            (self.path / RECORD).unlink(missing_ok=True)


def check_name(path: Path) -> None:
    """Reject an output name that no file can have, or that is not UTF-8 and cannot be recorded."""
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(str(path), "its name is not UTF-8", "another `folder=`") from None
    longest = max((len(part.encode()) for part in path.parts), default=0)
    if "\0" in str(path) or longest > MAX_NAME_BYTES:
        raise InputError(str(path), "no file can have this name", "another `folder=`")


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):
        return False
