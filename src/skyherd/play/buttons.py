"""Controls of the page that the filter of messages knows."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from skyherd.play.messages import MessageFilter

if TYPE_CHECKING:
    import viser

BUTTON = (33, 84, 140)
"""Colour of buttons. Chosen: white text on it has a contrast of 7.6, above the 4.5 of WCAG AA."""


class Controls:
    """Maker of controls, which the filter must know before it accepts their values.

    Attributes:
        gui: viser's interface, for displays and folders.

    Args:
        gui: as the attribute.
        allowed: the filter.
    """

    def __init__(self, gui: "viser.GuiApi", allowed: MessageFilter) -> None:
        self.gui, self._allowed = gui, allowed

    def known(self, handle: Any) -> Any:
        """Register a control, and return it."""
        self._allowed.register(handle)
        return handle

    def button(self, label: str, act: Callable[[], None], hint: str | None = None) -> Any:
        """Add a button that calls a function."""
        button = self.known(self.gui.add_button(label, color=BUTTON, hint=hint))
        button.on_click(ignoring_event(act))
        return button


def ignoring_event(act: Callable[[], None]) -> Callable[[object], None]:
    """Return a function that ignores the event which it is called with."""
    return lambda event: act()
