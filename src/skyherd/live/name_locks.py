"""Locks on names of a team, so that one machine runs each unit, robot, session and world once.

A lock is held from the start of a process to its end, also while the process is suspended, and the operating
system releases it when the process dies. It belongs to a team and to each radio endpoint of its lab: two lab
files with the same team and radio share it.
"""

import hashlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from skyherd.errors import InputError
from skyherd.live.lab import Lab

WAIT_S = 5.0
"""Time that a unit or robot waits for its name, s. Chosen: the processes of a session that was killed end
within a second or two, and their names are free then."""


def lock_folder() -> Path:
    """Return the folder of the locks, which all users of the machine share."""
    return Path("/tmp" if sys.platform != "win32" else tempfile.gettempdir()) / "skyherd-locks"


@contextmanager
def hold_name(lab: Lab, name: str, *, wait_s: float = 0.0) -> Iterator[None]:
    """Hold a name of a lab's team on this machine.

    Args:
        lab: the set-up, whose team and radio endpoints the lock belongs to.
        name: of the process, such as `robot/3`, or `live run` or `world`.
        wait_s: longest time to wait for another process to release it, s.

    Raises:
        InputError: another process holds it, or the lock cannot be made.
    """
    radio = lab.model.radio
    with ExitStack() as stack:
        for endpoint in sorted({*radio.listen, *radio.connect}):
            stack.enter_context(_hold(lab.model.team, endpoint, name, wait_s))
        yield


@contextmanager
def _hold(team: str, endpoint: str, name: str, wait_s: float) -> Iterator[None]:
    key = hashlib.sha256(f"{team}\0{endpoint}\0{name}".encode()).hexdigest()[:16]
    path = lock_folder() / f"{team}-{key}.lock"
    owner = path.with_suffix(".json")
    # Other users of the machine have to be able to open the lock, so it gets its mode explicitly.
    lock = FileLock(path, timeout=wait_s, mode=0o666)
    try:
        path.parent.mkdir(exist_ok=True)
        with suppress(OSError):
            path.parent.chmod(0o1777)
        lock.acquire()
    except Timeout:
        raise InputError(
            f"{name} of team {team}",
            f"already runs on this machine{_described(owner)}",
            "end that one first, or give this lab another team and radio",
        ) from None
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "a lock file that can be opened") from None
    try:
        with suppress(OSError):
            owner.write_text(json.dumps({"pid": os.getpid(), "since": time.strftime("%H:%M:%S")}))
        yield
    finally:
        lock.release()


def _described(owner: Path) -> str:
    """Return the process that holds a lock in words; empty if it is not known."""
    try:
        record = json.loads(owner.read_text())
        return f" (process {int(record['pid'])}, since {str(record['since'])[:8]})"
    except (OSError, ValueError, TypeError, KeyError):
        return ""
