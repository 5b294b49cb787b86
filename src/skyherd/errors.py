"""Every error that skyherd raises on purpose. They have one root, so that a caller can catch them all."""

from skyherd.text import shorten

MAX_CHARACTERS = 470
"""Characters of an InputError's three parts together. Chosen: the line on the terminal stays below 500
whatever was given, and nearly all lists of allowed values fit."""


class SkyherdError(Exception):
    """Root of all errors that skyherd raises on purpose.

    Attributes:
        exit_code: exit status of the command line when the error ends it.
    """

    exit_code = 1


class InputError(SkyherdError, ValueError):
    """An input of the user is wrong; the message is one line, `where: what; allowed`, of few characters.

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

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str], dict[str, object]]:
        """How it is pickled, on its way between processes: by its three parts, and with its notes."""
        return type(self), (self.where, self.what, self.allowed), vars(self)


class InputWarning(UserWarning):
    """An input of the user is read in part only; the message is one line, `where: what; what is read`."""


def _fitted(*parts: str) -> list[str]:
    """The parts, the longest of them shortened to one length, so that all have `MAX_CHARACTERS` together."""
    most = next(
        length
        for length in range(MAX_CHARACTERS, 0, -1)
        if sum(min(len(part), length) for part in parts) <= MAX_CHARACTERS
    )
    return [shorten(part, most) for part in parts]


class MessageError(SkyherdError, ValueError):
    """A message between the parts of the system has a wrong shape, type or value."""


class DegenerateSetError(SkyherdError, ValueError):
    """A set of points defines no similarity: there are fewer than two, or all lie in one place."""


class SingularSetError(DegenerateSetError):
    """A set of points is fitted best by a similarity of scale zero, so that no rotation fits best."""


class OutputError(SkyherdError, OSError):
    """A file could not be written, or not completely."""

    exit_code = 2
