"""Locks on process names, so that one machine runs each unit, robot, session and world of a team once.

A process holds its lock until it ends, also while it is suspended. The operating system releases the lock
when the process dies. A lock belongs to a team and a radio endpoint: labs with the same team and endpoint
share it.
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
"""Longest wait of a unit or robot for its name, s. Chosen: after a session was killed, its processes end and
release their names within two seconds."""


def lock_folder() -> Path:
    """Return the folder of the locks. All users of the machine share it."""
    return Path("/tmp" if sys.platform != "win32" else tempfile.gettempdir()) / "skyherd-locks"


@contextmanager
def hold_name(lab: Lab, name: str, *, wait_s: float = 0.0) -> Iterator[None]:
    """Hold a name of a lab's team on this machine.

    Args:
        lab: the set-up; its team and radio endpoints identify the lock.
        name: of the process, such as `robot/3`, or `live run` or `world`.
        wait_s: longest time to wait for another process to release it, s.

    Raises:
        InputError: another process holds the name, or the lock file cannot be opened.
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
    # Other users of the machine must be able to open the lock file, whatever the umask.
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
            "end that process first, or give this lab another team and radio",
        ) from None
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), "a lock file that can be opened") from None
    try:
        with suppress(OSError):
            owner.write_text(json.dumps({"pid": os.getpid(), "since": time.strftime("%H:%M:%S")}))
        yield
    finally:
        with suppress(OSError):
            owner.unlink(missing_ok=True)
        lock.release()


def _described(owner: Path) -> str:
    """Return a description of the process that holds a lock, or an empty string."""
    try:
        record = json.loads(owner.read_text())
        return f" (process {int(record['pid'])}, since {str(record['since'])[:8]})"
    except (OSError, ValueError, TypeError, KeyError):
        return ""
