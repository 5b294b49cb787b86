"""Endpoints of a radio's processes on this machine, by which a new process finds all of them.

The process that owns the port of the lab file may be suspended. It then accepts connections and answers none,
so that an operator who starts meanwhile would reach no robot. Each process therefore listens on a port of its
own, and writes that down in a folder which all processes of the machine share.
"""

import hashlib
import os
import random
import re
import socket
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from skyherd.live import name_locks

MAX_PEERS = 8
"""Largest number of processes that a new one connects to directly. Chosen: peers pass on each other's
endpoints, so that one which answers is enough."""

PLAIN = re.compile(r"tcp/127\.0\.0\.1:\d{1,5}")
"""Endpoints that are believed: other users of the machine can write into the folder."""


class LocalPeers:
    """The file of one process, and those of the others.

    Args:
        places: endpoints of the lab file; processes with the same ones are one team's.

    Attributes:
        own: endpoint of this process, on a port that is free now.
    """

    def __init__(self, places: Sequence[str]) -> None:
        key = hashlib.sha256("\0".join(sorted(set(places))).encode()).hexdigest()[:16]
        self._folder, self._prefix = name_locks.lock_folder(), f"peer-{key}-"
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.own = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        self._file = self._folder / f"{self._prefix}{os.getpid()}-{self.own.rpartition(':')[2]}"

    def others(self) -> list[str]:
        """Return the endpoints of other processes, `MAX_PEERS` at most; remove the files of dead ones."""
        found = []
        with suppress(OSError):
            for file in self._folder.glob(f"{self._prefix}*"):
                if not _runs(file.name.removeprefix(self._prefix).partition("-")[0]):
                    with suppress(OSError):
                        file.unlink()
                elif file != self._file and (endpoint := _endpoint(file)):
                    found.append(endpoint)
        return random.sample(found, min(MAX_PEERS, len(found)))

    def enter(self) -> None:
        """Write the endpoint down. Without the folder, others find it by the port of the lab file."""
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True)
            with suppress(OSError):
                self._folder.chmod(0o1777)
            self._file.write_text(self.own)

    def leave(self) -> None:
        """Remove the file of this process."""
        with suppress(OSError):
            self._file.unlink(missing_ok=True)


def _runs(number: str) -> bool:
    """Return whether a process of this number exists."""
    try:
        os.kill(int(number), 0)
    except PermissionError:
        return True
    except (ValueError, OverflowError, OSError):
        return False
    return True


def _endpoint(file: Path) -> str:
    """Return the endpoint in a file, or an empty string."""
    try:
        text = file.read_text()
    except (OSError, ValueError):
        return ""
    return text if PLAIN.fullmatch(text) else ""
