"""Worker processes and temporary folders that end with their parent process, even if it is killed.

A process cannot clean up after SIGKILL. On Linux the kernel therefore kills its workers (`end_with_parent`).
Elsewhere each worker watches a pipe that closes with its parent. A separate small process waits for the
parent's end, and removes a temporary folder (`temporary_folder`).
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
"""Option of `prctl` that sets the signal sent to a process when its parent ends. Defined by Linux."""

REMOVER = """
import os, shutil, sys, time
sys.stdin.read()
for _ in range(50):
    shutil.rmtree(sys.argv[1], ignore_errors=True)
    if not os.path.lexists(sys.argv[1]):
        break
    time.sleep(0.1)
"""
"""Program that removes a folder when its input ends. It tries for 5 s, as workers may still write there.
Chosen: workers end within milliseconds."""

REMOVER_S = 10.0
"""Timeout of `REMOVER`, s. Chosen: twice the time for which it tries."""


def end_with_parent() -> None:
    """Ensure that this process of multiprocessing ends when its parent ends, in any way.

    Call it in the main thread, before any work. The thread that started this process must live as long as the
    process is needed: Linux sends the signal at the end of that thread.
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
    """Prepare a worker process of a pool: it ends with its parent, and ignores Ctrl-C."""
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def temporary_folder(prefix: str) -> Iterator[Path]:
    """Make a temporary folder, which is removed after the body or at the end of this process.

    Args:
        prefix: prefix of its name.

    Raises:
        OSError: the folder cannot be made, or the process that removes it cannot be started.
    """
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    remover: subprocess.Popen[bytes] | None = None
    try:
        # A separate session does not get the signals of the terminal.
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
    """Close the input of the program that removes a folder, wait for its end, and kill it after a timeout."""
    if remover.stdin is not None:
        remover.stdin.close()
    try:
        remover.wait(REMOVER_S)
    except subprocess.TimeoutExpired:
        remover.kill()
        remover.wait()


def _signal_at_parents_end() -> bool:
    """Request SIGKILL from Linux at the end of the parent, and return whether that succeeded."""
    try:
        libc = ctypes.CDLL(None)
        return bool(libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0)
    except (OSError, AttributeError):
        return False


def _exit_with_parent() -> None:
    """Wait for the end of the parent, which closes a pipe, and end this process."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
