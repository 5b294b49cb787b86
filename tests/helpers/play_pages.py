"""Helpers of the tests of `skyherd play`."""

import asyncio
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

WAIT_S = 20.0
"""Time for a browser or the loop to do something, s. Chosen: a hundred times as long as it takes alone."""


def wait_until(condition, wait_s=WAIT_S):
    """Wait until a condition is true."""
    end_s = time.monotonic() + wait_s
    while not condition():
        assert time.monotonic() < end_s, "nothing happened"
        time.sleep(0.02)


def run_async(coroutine):
    """Run a coroutine in a thread of its own: a browser of the tests has an event loop in the present one."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, coroutine).result()


def moved(node, value):
    """Do what a browser's message about a control does: set its value, and call its functions."""
    node._impl.value = value
    for callback in node._impl.update_cb:
        result = callback(SimpleNamespace(client=object(), target=node))
        if asyncio.iscoroutine(result):
            run_async(result)
