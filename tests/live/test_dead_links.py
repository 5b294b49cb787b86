"""Robot process with links that fail while it is stopped: heartbeats, and confirmations of stops."""

import sys
import threading
import time
from types import SimpleNamespace

import pytest
from live_processes import wait_for

from skyherd.live.lab import make_lab
from skyherd.live.live_clock import LiveClock
from skyherd.live.process_context import ProcessContext
from skyherd.live.robot_process import run_robot
from skyherd.live.stop_latch import StopLatch
from skyherd.live.wire import Envelope, Heartbeat, Stop, decode, encode


class Wire:
    """Link that works until `fault` is set."""

    def __init__(self) -> None:
        self.fault, self.released = None, threading.Event()

    def write(self, motion) -> None:
        if self.fault is not None:
            self.fault()

    def close(self) -> None:
        pass

    def block(self) -> None:
        self.released.wait(30)

    def leave(self) -> None:
        sys.exit(3)

    def fail(self) -> None:
        raise RuntimeError("broken")


class Ether:
    """Radio that keeps published heartbeats, and delivers bytes on demand."""

    def __init__(self) -> None:
        self.beats, self.takers = [], []

    def publish(self, topic, data) -> None:
        envelope = decode(data, "links")
        if isinstance(envelope.message, Heartbeat):
            self.beats.append(envelope)

    def subscribe(self, pattern, take) -> None:
        if "/stop/" in pattern:
            self.takers.append(take)

    def close(self) -> None:
        pass


@pytest.fixture
def robot(tmp_path, monkeypatch):
    """Yield a link and a radio of a robot process in a thread."""
    wire, ether, ended = Wire(), Ether(), threading.Event()
    monkeypatch.setitem(sys.modules, "dead_links", SimpleNamespace(make=lambda robot_id, text: wire))
    lab = make_lab(
        {
            "team": "links",
            "shape": {"shape": "circle"},
            "markers": {"side_m": 0.1},
            "cameras": [{"address": "/dev/video0"}],
            "robots": [{"id": 0, "driver": "dead_links:make"}, {"id": 1}],
        }
    )
    context = ProcessContext(lab, ether, LiveClock(), tmp_path, lambda line: None, ended.is_set)
    process = threading.Thread(target=run_robot, args=(context, 0))
    process.start()
    wait_for(lambda: ether.beats and ether.beats[-1].message.halted == 0, "a zero at the link")
    yield wire, ether
    ended.set()
    wire.fault = None
    wire.released.set()
    process.join(10)


def send_stop(ether, number: int) -> None:
    data = encode(Envelope("operator", time.time(), Stop("test"), "x", StopLatch(number)), "links")
    for take in ether.takers:
        take(data)


@pytest.mark.parametrize(
    ("fault", "words"),
    [("block", "a write has blocked for"), ("leave", "SystemExit 3"), ("fail", "to: broken")],
)
def test_dead_link_is_reported_and_confirms_no_stop(robot, fault, words) -> None:
    wire, ether = robot
    wire.fault = getattr(wire, fault)
    send_stop(ether, 7)
    wait_for(lambda: words in ether.beats[-1].message.state, "the trouble in a heartbeat")
    beat = ether.beats[-1]
    assert beat.latch.stop == 7 and beat.message.halted < 7 and not beat.message.ready
    wire.fault = None
    wire.released.set()
    wait_for(lambda: ether.beats[-1].message.halted == 7, "the zero after the fault")
    assert ether.beats[-1].message.state == "stopped"
