"""The lock on a folder: one process at a time writes into it."""

import os
import sys
import time
from pathlib import Path
from weakref import WeakSet

if sys.platform != "win32":  # which has no such locks: there two processes must not be given one folder
    import fcntl

POLL_S = 0.05
"""How often a process that waits for a folder asks for it, s. *Chosen*: as often as a person cannot see."""


class FolderLock:
    """A lock on a folder, which is the open folder's, and ends with this process at the latest."""

    def __init__(self) -> None:
        self._open: int | None = None
        _locks.add(self)

    def acquire(self, folder: Path, wait_s: float) -> bool:
        """Lock a folder, and return whether that went well: another process may hold it for longer.

        On a system or a file system without such locks nothing is locked, and the answer is yes.

        Args:
            folder: the folder.
            wait_s: how long to wait for another process.
        """
        if sys.platform == "win32":
            return True
        ends_s = time.monotonic() + wait_s
        opened = os.open(folder, os.O_RDONLY)
        while True:
            try:
                fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() < ends_s:
                    time.sleep(POLL_S)
                    continue
                os.close(opened)
                return False
            except OSError:  # a file system without locks
                os.close(opened)
                return True
            self._open = opened
            return True

    def release(self) -> None:
        """Give the folder up, if it was locked."""
        if self._open is not None:
            os.close(self._open)
            self._open = None


_locks: WeakSet[FolderLock] = WeakSet()
"""All locks of this process."""


def _release_copies() -> None:
    """Close a forked process's copies of its maker's locks, which would hold folders after the maker ends."""
    for lock in _locks:
        lock.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_release_copies)
