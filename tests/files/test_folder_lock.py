"""Folder locks: exclusive, released by killed processes, and optional on file systems without locks."""

import errno
import subprocess
import sys
import time

import filelock
import pytest

from skyherd.files.folder_lock import LOCK, FolderLock

HOLD = """
import sys, time
from pathlib import Path
from skyherd.files.folder_lock import FolderLock
lock = FolderLock()
print(lock.acquire(Path(sys.argv[1]), 0.0), flush=True)
time.sleep(float(sys.argv[2]))
lock.release()
"""


def holder(folder, hold_s):
    """Start a process that holds the lock of a folder for a time, and return it."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(folder), str(hold_s)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "True\n"
    return process


def test_lock_is_exclusive_until_its_process_ends(tmp_path):
    lock = FolderLock()
    with holder(tmp_path, 0.5) as process:
        started_s = time.monotonic()
        assert not lock.acquire(tmp_path, 0.0)
        assert time.monotonic() - started_s < 0.4  # refused at once, before the other process ends
        assert lock.acquire(tmp_path, 30.0)
        assert process.wait(10.0) == 0
    lock.release()


@pytest.mark.smoke
def test_lock_file_of_killed_process_does_not_lock(tmp_path):
    with holder(tmp_path, 60.0) as process:
        assert not FolderLock().acquire(tmp_path, 0.0)
        process.kill()
        process.wait()
    assert (tmp_path / LOCK).exists()
    lock = FolderLock()
    assert lock.acquire(tmp_path, 0.0)
    lock.release()
    assert list(tmp_path.iterdir()) == []


def test_release_removes_the_lock_file_and_may_repeat(tmp_path):
    lock = FolderLock()
    assert lock.acquire(tmp_path, 0.0)
    assert [path.name for path in tmp_path.iterdir()] == [LOCK]
    lock.release()
    lock.release()
    assert list(tmp_path.iterdir()) == []


def test_lock_on_removed_file_is_not_acquired(tmp_path):
    """Three processes never hold the folder at the same time, although each release removes the lock file."""
    code = """
import os, sys, time
from pathlib import Path
from skyherd.files.folder_lock import FolderLock
folder, held = Path(sys.argv[1]), Path(sys.argv[1]) / "held"
for _ in range(40):
    lock = FolderLock()
    assert lock.acquire(folder, 30.0)
    os.close(os.open(held, os.O_CREAT | os.O_EXCL))  # fails if another process holds the folder
    time.sleep(0.001)
    held.unlink()
    lock.release()
"""
    processes = [subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) for _ in range(3)]
    assert [process.wait(60.0) for process in processes] == [0, 0, 0]


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS])
def test_file_system_without_locks_does_not_refuse(tmp_path, monkeypatch, number):
    def acquire(self, **_):
        raise OSError(number, "no locks")

    monkeypatch.setattr(filelock.FileLock, "acquire", acquire)
    lock = FolderLock()
    assert lock.acquire(tmp_path, 0.0)
    lock.release()


def test_folder_without_place_for_the_lock_file_is_an_error(tmp_path):
    (tmp_path / LOCK).mkdir()
    with pytest.raises(OSError, match="directory"):
        FolderLock().acquire(tmp_path, 0.0)
