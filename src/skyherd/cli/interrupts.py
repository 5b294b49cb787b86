"""Interrupts (Ctrl-C) and requests to end (SIGTERM, SIGHUP): one way out for all, which tidies up.

Each of the three signals becomes a KeyboardInterrupt in the main thread, so that resources are closed as
after an error. A verb states in `telling_of_interrupts` which files remain, and `skyherd.cli.main` prints it.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

CODES = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}
"""Exit codes by signal. Defined by shells: 128 and the signal's number."""


NOTHING_LEFT = "nothing is left of it"
"""Text of an interrupt if the verb says nothing else."""


class Interrupted(Exception):
    """Interrupt of a verb; the message names the remaining files. Typer would catch a KeyboardInterrupt."""


class EndRequest:
    """Request of a signal that the process ends.

    Attributes:
        name: of the first signal, such as SIGTERM; empty if there was none.
    """

    def __init__(self) -> None:
        self.name = ""
        self._asked = threading.Event()

    def ask(self, name: str = "") -> None:
        """Request the end, by a signal of this name or for another reason."""
        self.name = self.name or name
        self._asked.set()

    def is_asked(self) -> bool:
        """Return whether the end was requested."""
        return self._asked.is_set()

    @property
    def exit_code(self) -> int:
        """Return the exit code of a process that ended by the signal; 0 without one."""
        return CODES.get(self.name, 0)


@contextmanager
def signals_as_requests() -> Iterator[EndRequest]:
    """Let each signal of `CODES` ask for the end in the body, however often it comes, and raise nothing.

    For bodies that have to end in order, such as those that move robots or own other processes.
    """
    request = EndRequest()

    def ask(number: int, frame: FrameType | None) -> None:
        request.ask(signal.Signals(number).name)

    with _handling_signals(ask):
        yield request
        if request.name:
            # The process is about to end: another signal must not change its exit code any more.
            for name in CODES:
                if hasattr(signal, name) and signal.getsignal(getattr(signal, name)) is ask:
                    signal.signal(getattr(signal, name), signal.SIG_IGN)


class SignalReceived(KeyboardInterrupt):
    """Reception of one of `CODES`; `args[0]` is its name."""


@contextmanager
def signals_as_interrupts() -> Iterator[None]:
    """Let each signal of `CODES` raise SignalReceived in the body; restore the handlers afterwards."""
    with _handling_signals(_raise):
        yield


@contextmanager
def _handling_signals(handle: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle the signals of `CODES` in the body, apart from those that are ignored, as under nohup."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [getattr(signal, name) for name in CODES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        for number, handler in before.items():
            if handler not in (signal.SIG_IGN, None):
                signal.signal(number, handle)
        yield
    finally:
        for number, handler in before.items():
            if handler is not None and signal.getsignal(number) is handle:
                signal.signal(number, handler)


def _raise(number: int, frame: FrameType | None) -> None:
    raise SignalReceived(signal.Signals(number).name)


@contextmanager
def telling_of_interrupts(what_is_left: str | Callable[[], str]) -> Iterator[None]:
    """Convert an interrupt of the body into Interrupted, with a text about the remaining files.

    Args:
        what_is_left: the text, or a function that looks for remaining files and returns it.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        words = what_is_left if isinstance(what_is_left, str) else what_is_left()
        raise Interrupted(words, *error.args) from None


def describe(error: BaseException) -> tuple[str, int]:
    """Return the line to print of an interrupt, and the exit code.

    Args:
        error: Interrupted, or a KeyboardInterrupt that no verb has put into words.
    """
    left, *names = error.args if isinstance(error, Interrupted) else (NOTHING_LEFT, *error.args)
    name = names[0] if names else "SIGINT"
    said = "interrupted" if name == "SIGINT" else f"ended by {name}"
    return f"{said}; {left}", CODES.get(name, CODES["SIGINT"])
