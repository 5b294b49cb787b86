"""Helpers: order of answers, errors, and the end with their parent."""

import os
import signal
import subprocess
import sys
import threading
import time

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError, OutputError
from skyherd.files.folder_lock import FolderLock
from skyherd.jobs import helpers
from skyherd.jobs.helpers import Helper, can_help, cores, one_thread, shared

pytestmark = pytest.mark.skipif(not can_help(), reason="processes are forked on Linux only")

GONE = OutputError("the helper is gone")

LIMIT_S = 60.0
"""Timeout of a test for a process, s. Chosen: thousands of times the usual duration."""


def alive(pid):
    """Return whether a process exists and is not a zombie."""
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_until(true):
    ends = time.monotonic() + LIMIT_S
    while not true():
        assert time.monotonic() < ends
        time.sleep(0.01)


class Adder:
    """Server that returns the sum of all requests, and its process id."""

    def __init__(self):
        self.total = 0

    def add(self, number):
        if number is None:
            raise InputError("number", "none", "a number")
        self.total += number
        return self.total, os.getpid()


@pytest.mark.smoke
def test_helper_answers_in_order_and_keeps_state():
    adder = Adder()
    adder.add(100)  # Set before the fork, so that the helper inherits it.
    with Helper(adder.add, GONE, waiting=3) as helper:
        for number in range(5):
            helper.ask(number)
        answers = [helper.answer() for _ in range(5)]
    assert [total for total, _ in answers] == [100, 101, 103, 106, 110]
    assert {pid for _, pid in answers} != {os.getpid()} and len({pid for _, pid in answers}) == 1
    assert adder.total == 100
    assert not alive(answers[0][1])


def test_helper_survives_error_and_passes_it_on():
    with Helper(Adder().add, GONE) as helper:
        helper.ask(None)
        helper.ask(7)
        with pytest.raises(InputError, match="number: none; a number") as caught:
            helper.answer()
        assert caught.value.allowed == "a number"
        assert "in add" in caught.value.__notes__[0]
        assert helper.answer()[0] == 7


def test_unpicklable_error_is_reported():
    class Local(Exception):
        pass

    def fail(request):
        raise Local(f"no {request}")

    with Helper(fail, GONE) as helper:
        helper.ask("luck")
        with pytest.raises(RuntimeError, match="Local: no luck"):
            helper.answer()


def test_pending_requests_do_not_block_maker():
    """Each request is larger than a pipe's buffer, so that the parent would block without a reader."""
    release, image = threading.Event(), np.zeros(10**6, np.uint8)

    def hold(request):
        if request is None:
            time.sleep(LIMIT_S)
        return 0

    with Helper(hold, GONE, waiting=4) as helper:
        helper.ask(None)
        asking = threading.Thread(target=lambda: ([helper.ask(image) for _ in range(3)], release.set()))
        asking.start()
        assert release.wait(LIMIT_S / 2)
        asking.join()
        assert not helper.answered()
        os.kill(helper._process.pid, signal.SIGKILL)


def test_killed_helper_is_reported():
    with Helper(Adder().add, GONE) as helper:
        os.kill(helper._process.pid, signal.SIGKILL)
        with pytest.raises(OutputError, match="the helper is gone"):
            helper.answer()
        with pytest.raises(OutputError, match="the helper is gone"):
            helper.ask(1)


def test_helper_leaves_signals_to_maker():
    with Helper(Adder().add, GONE) as helper:
        for name in helpers.SIGNALS:
            os.kill(helper._process.pid, getattr(signal, name))
        helper.ask(3)
        assert helper.answer()[0] == 3


@pytest.mark.parametrize("how", ["killed", "killed at work", "ended without closing"])
def test_helpers_end_with_their_maker(how):
    """With three helpers, later forks inherit copies of the earlier ones' pipes."""
    code = f"""
import time
from skyherd.jobs.helpers import Helper
all = [Helper(time.sleep, RuntimeError()) for _ in range(3)]
{"[helper.ask(600) for helper in all]" if how == "killed at work" else ""}
print(*[helper._process.pid for helper in all], flush=True)
{"time.sleep(600)" if how != "ended without closing" else ""}
"""
    maker = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    pids = [int(pid) for pid in maker.stdout.readline().split()]
    assert len(pids) == 3
    if how != "ended without closing":
        assert all(map(alive, pids))
        maker.kill()
    maker.wait(LIMIT_S)
    wait_until(lambda: not any(map(alive, pids)))
    maker.stdout.close()


def test_hanging_helper_is_killed_on_close(monkeypatch):
    monkeypatch.setattr(helpers, "PATIENCE_S", 0.2)
    helper = Helper(time.sleep, GONE)
    helper.ask(LIMIT_S)
    helper.close()
    assert not helper._process.is_alive()
    helper.close()  # twice does nothing


def test_helper_does_not_hold_folder_lock(tmp_path):
    """A killed process releases its folder at once, although its helpers end a moment later."""
    ours, theirs = FolderLock(), FolderLock()
    assert ours.acquire(tmp_path, 0.0)
    with Helper(Adder().add, GONE) as helper:
        helper.ask(1)
        assert helper.answer()[0] == 1  # it is there, and has been forked with the lock
        assert not theirs.acquire(tmp_path, 0.0)  # it has not given up what its maker still holds
        ours.release()
        assert theirs.acquire(tmp_path, 0.0)
    theirs.release()


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_shared_work_keeps_order(jobs):
    found = shared(lambda number: (number**2, os.getpid()), range(7), jobs, GONE)
    assert [square for square, _ in found] == [number**2 for number in range(7)]
    pids = {pid for _, pid in found}
    assert len(pids) <= jobs and (os.getpid() in pids) == (jobs == 1)


def test_shared_work_ends_with_first_error():
    def fail(number):
        if number == 3:
            raise InputError("number", "3", "another")
        return number

    with pytest.raises(InputError, match="number: 3; another"):
        shared(fail, range(100), 2, GONE)
    assert not helpers._open


def test_opencv_has_one_thread_inside_context():
    before = cv2.getNumThreads()
    with one_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before


def test_cores_match_process_affinity():
    mine = os.sched_getaffinity(0)
    assert cores() == len(mine)
    try:
        os.sched_setaffinity(0, {min(mine)})
        assert cores() == 1
    finally:
        os.sched_setaffinity(0, mine)
