"""Measure the steps per second of `skyherd play`: alone, with its page, and with stuck browsers.

    python benchmarks/play.py [SCENARIO] [--set KEY=VALUE ...] [--seconds 15] [--browsers 3]

A stuck browser has opened its WebSocket and reads nothing. It must cost the loop nothing.
"""

import argparse
import base64
import secrets
import socket
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from threading import Thread
from time import monotonic, sleep

import viser
from command import run

from skyherd.loop import Step
from skyherd.play.page import Page
from skyherd.play.session import End, Session
from skyherd.report.access import Access, bind

WARM_UP_S = 3.0
"""Time before each measurement, s. Chosen: compiled functions are ready, and browsers connected."""


def handshake(access: Access) -> bytes:
    """Return the request of a browser that opens the page's WebSocket."""
    own = f"127.0.0.1:{access.port}"
    headers = {
        "Host": own,
        "Origin": f"http://{own}",
        "Cookie": f"{access.cookie}={access.token}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": base64.b64encode(secrets.token_bytes(16)).decode(),
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }
    lines = ["GET / HTTP/1.1", *(f"{name}: {value}" for name, value in headers.items())]
    return "\r\n".join([*lines, "", ""]).encode()


@contextmanager
def stuck_browser(access: Access) -> Iterator[None]:
    """Open a WebSocket and read nothing but the first bytes of the answer."""
    with socket.create_connection(("127.0.0.1", access.port)) as connection:
        connection.sendall(handshake(access))
        if b"101" not in connection.recv(64):
            raise RuntimeError("the page refused a browser")
        yield


class CountingSession(Session):
    """Session that counts its steps."""

    count = 0

    def steps(self) -> Iterator[Step]:
        """Yield the steps, and count them."""
        for step in super().steps():
            self.count += 1
            yield step

    def rate(self, seconds: float) -> float:
        """Return the steps per second over a time, while another thread iterates `steps`."""
        sleep(WARM_UP_S)
        start_s, before = monotonic(), self.count
        sleep(seconds)
        return (self.count - before) / (monotonic() - start_s)


@contextmanager
def running(session: Session, run_it: Callable[[], object]) -> Iterator[None]:
    """Run a session in a thread."""
    thread = Thread(target=run_it)
    thread.start()
    try:
        yield
    finally:
        session.ask(End())
        thread.join()


def main() -> None:
    """Print the rates."""
    parser = argparse.ArgumentParser(description="Steps per second of `skyherd play`.")
    parser.add_argument("scenario", nargs="?", default="star")
    parser.add_argument("--set", action="append", default=[], dest="settings", metavar="KEY=VALUE")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--browsers", type=int, default=3)
    given = parser.parse_args()

    def opened() -> CountingSession:
        return CountingSession.open(given.scenario, given.settings, folder=Path(), speed=None)

    session = opened()
    with running(session, lambda: deque(session.steps(), maxlen=0)):
        print(f"loop alone        {session.rate(given.seconds):7.1f} steps/s")
    for browsers in (0, given.browsers):
        session = opened()
        with bind("127.0.0.1", 0) as listener:
            page = Page(session, Access.make("127.0.0.1", listener.getsockname()[1]), listener)
            with closing(page), running(session, page.run), ExitStack() as stack:
                for _ in range(browsers):
                    stack.enter_context(stuck_browser(page.access))
                print(f"{browsers} stuck browsers  {session.rate(given.seconds):7.1f} steps/s")


if __name__ == "__main__":
    run(main)
