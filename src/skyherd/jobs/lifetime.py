"""Processes and temporary folders that end with their parent process, even if it is killed.

A process that gets SIGKILL cannot clean up. On Linux the kernel therefore kills its workers
(`end_with_parent`). On other systems each worker watches a pipe that closes with its parent. A separate
process waits for the end of this process and removes its temporary folder (`temporary_folder`).
"""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from pathlib import Path

PR_SET_PDEATHSIG = 1
"""Option of `prctl` for the signal that a process gets when its parent ends. *Defined* by Linux."""

REMOVER = """
import os, shutil, sys, time
sys.stdin.read()
for _ in range(50):
    shutil.rmtree(sys.argv[1], ignore_errors=True)
    if not os.path.lexists(sys.argv[1]):
        break
    time.sleep(0.1)
"""
"""Program that removes a folder when its input ends. It retries for 5 s, while workers may still write there.
*Chosen*: workers end within milliseconds."""

REMOVER_S = 10.0
"""Longest time to wait for the program, s. *Chosen*: twice the time of its retries."""


def end_with_parent() -> None:
    """Make the system kill this process, created by multiprocessing, when its parent ends in any way.

    Call it in the process's main thread, before any work. Linux sends the signal at the end of the thread
    that created the process. That thread must therefore live as long as the process is needed.
    """
    parent = parent_process()
    if parent is None:
        return
    if sys.platform == "linux" and _signal_at_parents_end():
        if os.getppid() != parent.pid:  # The parent ended before the signal was set.
            os._exit(1)
        return
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def start_worker() -> None:
    """Prepare a worker process of a pool: it ends with its parent, and ignores interrupts."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """Create a folder for temporary files, which is removed after the body or at the end of this process.

    Args:
        prefix: beginning of its name.

    Raises:
        OSError: the folder cannot be created.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    remover: subprocess.Popen[bytes] | None = None
    try:
        # In its own session the process does not get the terminal's signals.
        remover = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", REMOVER, str(folder)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            cwd=folder.parent,
        )
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if remover is not None:
            _end(remover)


def _end(remover: "subprocess.Popen[bytes]") -> None:
    """Close the input of the program that removes a folder, and wait for it."""
    if remover.stdin is not None:
        remover.stdin.close()
    try:
        remover.wait(REMOVER_S)
    except subprocess.TimeoutExpired:
        remover.kill()
        remover.wait()


def _signal_at_parents_end() -> bool:
    """Request that Linux kills this process at the end of its parent, and return whether it succeeded."""
    try:
        libc = ctypes.CDLL(None)
        return bool(libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0)
    except (OSError, AttributeError):
        return False


def _exit_with_parent() -> None:
    """Wait for the end of the parent, and end this process."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
