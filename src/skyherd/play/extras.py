"""Check for the optional libraries of `skyherd[play]`."""

from importlib.util import find_spec

from skyherd.errors import InputError


def require_viser(verb: str) -> None:
    """Check that viser is installed for a verb; it is not imported, which takes a second.

    Raises:
        InputError: it is not installed.
    """
    if find_spec("viser") is None:
        raise InputError(f"skyherd {verb}", "viser is not installed", "pip install 'skyherd[play]'")
