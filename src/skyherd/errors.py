"""Errors that skyherd raises on purpose, with one common base class."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Self

from skyherd.text import shorten

MAX_CHARACTERS = 470
"""Maximum length of an InputError's three parts together, characters. Chosen: a terminal line stays below
500 characters, and nearly all lists of allowed values fit."""

MAX_PROBLEMS = 10
"""Problems that one error lists; the rest are counted. *Chosen*: half the height of a small terminal."""


class SkyherdError(Exception):
    """Base class of all errors that skyherd raises on purpose.

    Attributes:
        exit_code: exit status of the command line when the error ends it.
    """

    exit_code = 1


class InputError(SkyherdError, ValueError):
    """Invalid user input; the message is one short line, `where: what; allowed`.

    Args:
        where: the file, key or argument.
        what: the value given, or what is wrong with it.
        allowed: what would be accepted, or what to do.
    """

    exit_code = 2

    def __init__(self, where: str, what: str, allowed: str) -> None:
        # The text of an array is of several lines.
        parts = str(where), " ".join(str(what).split("\n")), str(allowed)
        self.where, self.what, self.allowed = _fitted(*parts)
        super().__init__(f"{self.where}: {self.what}; {self.allowed}")

    @property
    def problems(self) -> tuple["InputError", ...]:
        """The single problems that it stands for."""
        return (self,)

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines to print, one for each problem."""
        return (str(self),)

    def within(self, where: str) -> "InputError":
        """Return the same error with a place put before its own."""
        return InputError(f"{where}: {self.where}", self.what, self.allowed)

    def within_key(self, key: str) -> "InputError":
        """Return the same error, its place a key below another key."""
        return InputError(f"{key}.{self.where}" if self.where else key, self.what, self.allowed)

    def __reduce__(self) -> tuple[type[Self], tuple[object, ...], dict[str, object]]:
        """Return the three parts and the notes, by which the error is pickled between processes."""
        return type(self), (self.where, self.what, self.allowed), vars(self)


class InputErrors(InputError):
    """Several problems of one input; the message has a line for each, at most `MAX_PROBLEMS`.

    `where`, `what` and `allowed` are those of the first problem.

    Args:
        problems: the single problems, at least one.
        more: number of further problems, which are only counted.
    """

    def __init__(self, problems: Sequence[InputError], more: int = 0) -> None:
        self._problems, self.more = tuple(problems), more
        super().__init__(problems[0].where, problems[0].what, problems[0].allowed)
        self.args = ("\n".join(self.lines),)

    @property
    def problems(self) -> tuple[InputError, ...]:
        """The single problems that it stands for."""
        return self._problems

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines to print: one for each problem, and one that counts those left out."""
        more = self.more + max(0, len(self._problems) - MAX_PROBLEMS)
        rest = [f"and {more} more problem{'s' * (more != 1)}"] if more else []
        return (*map(str, self._problems[:MAX_PROBLEMS]), *rest)

    def within(self, where: str) -> InputError:
        """Return the same problems with a place put before that of each."""
        return InputErrors([problem.within(where) for problem in self._problems], self.more)

    def __reduce__(self) -> tuple[type[Self], tuple[object, ...], dict[str, object]]:
        """Return the problems and the notes, by which the error is pickled between processes."""
        return type(self), (self._problems, self.more), vars(self)


def join_errors(errors: Sequence[InputError], more: int = 0) -> InputError:
    """Return one error that stands for the problems of several, each problem once.

    Args:
        errors: at least one error.
        more: number of further problems, which are only counted.
    """
    more += sum(error.more for error in errors if isinstance(error, InputErrors))
    problems = {str(problem): problem for error in errors for problem in error.problems}
    first, *others = problems.values()
    return InputErrors([first, *others], more) if others or more else first


class ProblemCollector:
    """Collects the problems that several checks of one input find, to report them together."""

    def __init__(self) -> None:
        self.errors: list[InputError] = []

    @contextmanager
    def collecting(self) -> Iterator[None]:
        """Keep an InputError of the body, and go on after it."""
        try:
            yield
        except InputError as error:
            self.errors.append(error)

    def raise_all(self) -> None:
        """Raise the problems that were collected, if any, as one error.

        Raises:
            InputError: a check found a problem.
        """
        if self.errors:
            raise join_errors(self.errors) from None


class InputWarning(UserWarning):
    """User input that is only partly read; the message is `where: what; what is read`."""


def _fitted(*parts: str) -> list[str]:
    """Return the parts, the longest shortened to one length, with `MAX_CHARACTERS` at most in total."""
    most = next(
        length
        for length in range(MAX_CHARACTERS, 0, -1)
        if sum(min(len(part), length) for part in parts) <= MAX_CHARACTERS
    )
    return [shorten(part, most) for part in parts]


class MessageError(InputError):
    """Message between parts of the system with a wrong shape, type or value."""


class DegenerateSetError(InputError):
    """Point set that defines no similarity: fewer than two points, or all coincident."""


class SingularSetError(DegenerateSetError):
    """Point set whose best similarity has scale zero, so that the rotation is undefined."""


class OutputError(SkyherdError, OSError):
    """File that could not be written, or not completely."""

    exit_code = 2


class NativeLibraryError(SkyherdError, ImportError):
    """Compiled library that is missing, cannot be loaded, or is of another version."""

    exit_code = 2
