"""The lock on a folder: one process at a time writes into it."""

import errno
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from filelock import BaseFileLock

LOCK = ".skyherd.lock"
"""Name of the lock file, which is in the folder as long as it is locked."""

NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP}
"""Errors of file systems that have no locks."""


class FolderLock:
    """A lock on a folder, held through a lock file in it.

    The lock ends with this process at the latest. A lock file that a killed process left does not lock. A
    forked process does not inherit the lock.
    """

    def __init__(self) -> None:
        self._held: BaseFileLock | None = None

    def acquire(self, folder: Path, wait_s: float) -> bool:
        """Lock a folder, and return False if another process holds it for longer.

        On a file system without locks nothing is locked, and the answer is True.

        Args:
            folder: the folder.
            wait_s: how long to wait for another process.

        Raises:
            OSError: the lock file cannot be made.
        """
        from filelock import FileLock, Timeout

        lock = FileLock(folder / LOCK, thread_local=False, fallback_to_soft=False)
        try:
            lock.acquire(timeout=wait_s)
        except Timeout:
            return False
        except OSError as error:
            if error.errno not in NO_LOCKS:
                raise
            _remove(folder / LOCK)
            return True
        self._held = lock
        return True

    def release(self) -> None:
        """Unlock the folder, if it was locked, and remove the lock file.

        The file is removed before it is unlocked. A process that waits for the removed file is not given its
        lock: `filelock` checks that the file still has a name.
        """
        if self._held is not None:
            _remove(Path(self._held.lock_file))
            self._held.release()
            self._held = None


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink()
