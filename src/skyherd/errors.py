"""Every error that skyherd raises on purpose. They have one root, so that a caller can catch them all."""


class SkyherdError(Exception):
    """Root of all errors that skyherd raises on purpose.

    Attributes:
        exit_code: exit status of the command line when the error ends it.
    """

    exit_code = 1


class InputError(SkyherdError, ValueError):
    """An input of the user is wrong; the message is one line, `where: what; allowed`.

    Args:
        where: the file, key or argument.
        what: the value given, or what is wrong with it.
        allowed: what would be accepted, or what to do.
    """

    exit_code = 2

    def __init__(self, where: str, what: str, allowed: str) -> None:
        self.where, self.what, self.allowed = where, what, allowed
        super().__init__(f"{where}: {what}; {allowed}")


class MessageError(SkyherdError, ValueError):
    """A message between the parts of the system has a wrong shape, type or value."""


class DegenerateSetError(SkyherdError, ValueError):
    """A set of points defines no similarity: there are fewer than two, or all lie in one place."""


class OutputError(SkyherdError, OSError):
    """A file could not be written, or not completely."""

    exit_code = 2
