"""Measure `skyherd play`: steps per second, delay of a change, and memory with a slow browser.

    python benchmarks/play.py [SCENARIO] [--set KEY=VALUE ...] [--seconds 15] [--browsers 3]
    python benchmarks/play.py --changes 200                # delay of a slider
    python benchmarks/play.py --slow 600                   # memory with a slow browser

A stuck browser has opened its WebSocket and reads nothing. It must cost the loop nothing. The delay is from
the request that a slider makes to the sending of the first image that shows it, at speed 1.
"""

import argparse
import base64
import os
import secrets
import socket
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from threading import Event, Thread
from time import monotonic, sleep

import msgspec
import numpy as np
import viser
from command import run

from skyherd.loop import Step
from skyherd.play.page import Page
from skyherd.play.session import Change, End, Session
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


VIEW = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [0, 0, 9.5],
    "fov": 1.0,
    "near": 0.1,
    "far": 100,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}
"""First message of a browser, without which viser sends it nothing."""


def introduce(connection: socket.socket, access: Access) -> None:
    """Open the WebSocket of a page, and send the first message of a browser."""
    connection.sendall(handshake(access))
    while b"\r\n\r\n" not in (head := connection.recv(4096, socket.MSG_PEEK)):
        sleep(0.01)
    connection.recv(head.index(b"\r\n\r\n") + 4)
    body = msgspec.msgpack.encode(VIEW)
    # A final binary frame of at least 126 bytes, masked by zeros.
    connection.sendall(b"\x82\xfe" + len(body).to_bytes(2, "big") + bytes(4) + body)


def read_message(connection: socket.socket) -> None:
    """Read one frame of a WebSocket, which a server does not mask."""
    length = _read(connection, 2)[1]
    if length >= 126:
        length = int.from_bytes(_read(connection, 2 if length == 126 else 8), "big")
    _read(connection, length)


def _read(connection: socket.socket, count: int) -> bytes:
    parts = bytearray()
    while len(parts) < count:
        part = connection.recv(min(count - len(parts), 1 << 16))
        if not part:
            raise ConnectionError("the page closed the connection")
        parts += part
    return bytes(parts)


def measure_slow_browser(opened: Callable[[], "CountingSession"], seconds: float) -> None:
    """Print the memory of the process while a browser reads one message a second."""
    session = opened()
    with bind("127.0.0.1", 0) as listener:
        page = Page(session, Access.make("127.0.0.1", listener.getsockname()[1]), listener)
        server = "127.0.0.1", page.access.port
        with closing(page), running(session, page.run), socket.create_connection(server) as connection:
            introduce(connection, page.access)
            while not page.server.get_clients():
                sleep(0.01)
            is_open, began_s, shown_s = True, monotonic(), -np.inf
            while (now_s := monotonic() - began_s) < seconds:
                if now_s - shown_s >= seconds / 10:
                    shown_s = now_s
                    print(f"{now_s:6.0f} s  {resident_mb():7.1f} MB  {session.count} steps", flush=True)
                if is_open:
                    try:
                        read_message(connection)
                    except OSError:
                        is_open = False
                        print(f"{now_s:6.0f} s  the page closed the slow connection", flush=True)
                sleep(1.0)
            print(f"{seconds:6.0f} s  {resident_mb():7.1f} MB  {session.count} steps")


def resident_mb() -> float:
    """Return the memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure_delay(session: Session, changes: int) -> None:
    """Print the delay from a change of a zoom to the sending of an image that shows it."""
    with bind("127.0.0.1", 0) as listener:
        page = Page(session, Access.make("127.0.0.1", listener.getsockname()[1]), listener)
        show, shown = page._panel.show, Event()
        wanted = 1.0

        def spying(step: Step, mission: object, images: list) -> None:
            show(step, mission, images)
            if step.fleet.zooms[0] == wanted and any(image.unit == 0 for image in images):
                shown.set()

        page._panel.show = spying
        delays_s = []
        with closing(page), running(session, page.run):
            sleep(WARM_UP_S)
            for number in range(changes):
                wanted = 1.0 + 0.1 * ((number + 1) % 2)
                shown.clear()
                began_s = monotonic()
                session.ask(Change(({"kind": "camera", "unit": 0, "zoom": wanted},)))
                if not shown.wait(20.0):
                    raise RuntimeError("a change was not shown within 20 s")
                delays_s.append(monotonic() - began_s)
                sleep(0.13 + 0.01 * (number % 17))
        median, p99 = np.quantile(delays_s, [0.5, 0.99])
        print(f"slider to image: median {median:.3f} s, 99 % within {p99:.3f} s, {changes} changes")


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
    parser.add_argument("--changes", type=int, help="measure the delay of this many changes")
    parser.add_argument("--slow", type=float, help="measure memory for this time, s")
    given = parser.parse_args()

    def opened(speed: float | None = None) -> CountingSession:
        return CountingSession.open(given.scenario, given.settings, folder=Path(), speed=speed)

    if given.changes is not None:
        measure_delay(opened(1.0), given.changes)
        return
    if given.slow is not None:
        measure_slow_browser(partial(opened, 1.0), given.slow)
        return
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
