"""Custom cameras: `module:factory`, or `module:factory=TEXT`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from skyherd.errors import InputError
from skyherd.live.cameras.frame import Picture
from skyherd.plugins import import_factory

ALLOWED = "a function that takes a text and yields grey pictures (height, width) of 8 bits"
"""Required signature of a factory, for error messages."""


class PluginCamera:
    """Camera whose pictures come from a custom function.

    `factory(text)` returns an iterable of pictures. Each is an array (height, width) of uint8, or a `Picture`
    with its times. The reader calls the factory again after the iterable ended or failed. It calls the
    iterable's method `close`, if any.

    Args:
        address: `module:factory`, with `=TEXT` for the argument of the factory.

    Raises:
        InputError: the factory does not exist.
    """

    lasting = True
    pace: Literal["live"] = "live"

    def __init__(self, address: str) -> None:
        self.name, _, self._text = address.partition("=")
        self._factory = import_factory(self.name, f"camera {self.name}", ALLOWED)

    @contextmanager
    def open(self, pause: Callable[[float], bool]) -> Iterator[Iterator[Picture]]:
        """Call the factory; see `Source.open`."""
        given = self._factory(self._text)
        try:
            yield (self._picture(item) for item in given)
        finally:
            with suppress(AttributeError):
                given.close()

    def _picture(self, item: Any) -> Picture:
        picture = item if isinstance(item, Picture) else Picture(item)
        image = np.array(picture.image)
        if image.ndim != 2 or image.dtype != np.uint8 or not image.size:
            raise InputError(f"camera {self.name}", f"yields array {image.shape} of {image.dtype}", ALLOWED)
        return replace(picture, image=image)
