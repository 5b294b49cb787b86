"""Every error skyherd raises on purpose; one root, so that a caller can catch them all."""


class SkyherdError(Exception):
    """Root of all errors raised on purpose; `exit_code` is what the command line returns for it."""

    exit_code = 1


class InputError(SkyherdError, ValueError):
    """Something the user gave is wrong: says where, what, and what is allowed, in one line."""

    exit_code = 2

    def __init__(self, where: str, what: str, allowed: str) -> None:
        self.where, self.what, self.allowed = where, what, allowed
        super().__init__(f"{where}: {what}; {allowed}")


class MessageError(SkyherdError, ValueError):
    """A message between the parts was made with a wrong shape, type or value."""


class DegenerateSetError(SkyherdError, ValueError):
    """A point set defines no similarity: fewer than two points, or all on one spot."""


class OutputError(SkyherdError, OSError):
    """A file could not be written or did not become whole."""

    exit_code = 2
