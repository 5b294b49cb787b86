"""Helpers for tests of real processes: free ports, and waiting with a timeout."""

import socket
import time

PATIENCE_S = 120.0


def free_port() -> int:
    with socket.socket() as there:
        there.bind(("127.0.0.1", 0))
        return int(there.getsockname()[1])


def wait_for(holds, what: str) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end_s, what
        time.sleep(0.05)
