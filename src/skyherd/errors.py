"""Errors that skyherd raises on purpose, with one common base class."""

from skyherd.text import shorten

MAX_CHARACTERS = 470
"""Maximum length of an InputError's three parts together, characters. Chosen: a terminal line stays below
500 characters, and nearly all lists of allowed values fit."""


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
        # The text of an array has several lines.
        self.where, self.what, self.allowed = _fitted(where, " ".join(what.split("\n")), allowed)
        super().__init__(f"{self.where}: {self.what}; {self.allowed}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str], dict[str, object]]:
        """Pickle the error by its three parts, with its notes."""
        return type(self), (self.where, self.what, self.allowed), vars(self)


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


class MessageError(SkyherdError, ValueError):
    """Message between parts of the system with a wrong shape, type or value."""


class DegenerateSetError(SkyherdError, ValueError):
    """Point set that defines no similarity: fewer than two points, or all coincident."""


class SingularSetError(DegenerateSetError):
    """Point set whose best similarity has scale zero, so that the rotation is undefined."""


class OutputError(SkyherdError, OSError):
    """File that could not be written, or not completely."""

    exit_code = 2
