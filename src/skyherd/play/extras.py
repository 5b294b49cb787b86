"""Check for the optional libraries of `skyherd[play]`."""

from importlib.util import find_spec

from skyherd.errors import InputError


def require_viser() -> None:
    """Check that viser is installed; it is not imported, which takes a second.

    Raises:
        InputError: it is not installed.
    """
    if find_spec("viser") is None:
        raise InputError("skyherd play", "viser is not installed", "pip install 'skyherd[play]'")
