"""Messages of a browser, checked before viser acts on them.

Only the kinds below exist on the page. Requests for viser's public relay, uploads and rendered images are
refused like any unknown kind.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal

import msgspec

MAX_BYTES = 16_384
"""Maximum size of a message, bytes. Chosen: twenty times the largest that the page sends."""

MAX_TEXT = 60
"""Maximum length of a typed text, characters. Chosen: longer than any word that robots write."""

Name = Annotated[str, msgspec.Meta(max_length=120)]
Number = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
Point = tuple[Number, Number, Number]
Turn = tuple[Number, Number, Number, Number]


class Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """Base of the messages, told apart by their key `type`."""


class ViewerCamera(Message, tag="ViewerCameraMessage"):
    """Place and direction of the observer."""

    wxyz: Turn
    position: Point
    fov: Number
    near: Number
    far: Number
    image_height: Annotated[int, msgspec.Meta(ge=0, le=100_000)]
    image_width: Annotated[int, msgspec.Meta(ge=0, le=100_000)]
    look_at: Point
    up_direction: Point


class GuiUpdate(Message, tag="GuiUpdateMessage"):
    """New value of a control."""

    uuid: Name
    updates: dict[Name, Any]


class CommandTrigger(Message, tag="CommandTriggerMessage"):
    """Key or entry of the command palette."""

    uuid: Name


class Moved(Message, tag="TransformControlsUpdateMessage"):
    """Place of a handle in the scene that is being dragged."""

    name: Name
    wxyz: Turn
    position: Point
    owner: Name = ""


class MoveStart(Message, tag="TransformControlsDragStartMessage"):
    """Start of dragging a handle."""

    name: Name
    owner: Name = ""


class MoveEnd(Message, tag="TransformControlsDragEndMessage"):
    """End of dragging a handle."""

    name: Name
    owner: Name = ""


class NodeClick(Message, tag="SceneNodeClickMessage"):
    """Click on an object of the scene."""

    name: Name
    instance_index: int | None
    ray_origin: Point
    ray_direction: Point
    screen_pos: tuple[Number, Number]
    modifier: Name | None
    owner: Name = ""


class GroundClick(Message, tag="ScenePointerMessage"):
    """Click anywhere in the scene."""

    event_type: Literal["click"]
    ray_origin: Point
    ray_direction: Point
    screen_pos: tuple[tuple[Number, Number]]
    modifier: Name | None


Known = ViewerCamera | GuiUpdate | CommandTrigger | Moved | MoveStart | MoveEnd | NodeClick | GroundClick
"""Kinds of messages that are acted on."""

_DECODER = msgspec.msgpack.Decoder(Known)

ValueCheck = Callable[[Any], bool]
"""Function that returns whether a control can have a value."""


class MessageFilter:
    """Filter of messages; it knows the controls of the page and their ranges."""

    def __init__(self) -> None:
        self._checks: dict[str, ValueCheck] = {}

    def register(self, handle: Any) -> None:
        """Accept values for a control, within its range."""
        self._checks[handle._impl.uuid] = value_check(handle)

    def accepts(self, raw: object) -> bool:
        """Return whether viser may act on a message."""
        if not isinstance(raw, bytes) or len(raw) > MAX_BYTES:
            return False
        try:
            message = _DECODER.decode(raw)
        except (msgspec.DecodeError, RecursionError):
            return False
        if isinstance(message, GuiUpdate):
            check = self._checks.get(message.uuid)
            return check is not None and set(message.updates) == {"value"} and check(message.updates["value"])
        return True


def value_check(handle: Any) -> ValueCheck:
    """Return the check of the values that a control of viser can have."""
    import viser

    match handle:
        case viser.GuiButtonHandle() | viser.GuiCheckboxHandle():
            return lambda value: isinstance(value, bool)
        case viser.GuiDropdownHandle() | viser.GuiButtonGroupHandle():
            return lambda value: isinstance(value, str) and value in handle.options
        case viser.GuiTextHandle():
            return lambda value: isinstance(value, str) and len(value) <= MAX_TEXT and value.isprintable()
        case viser.GuiNumberHandle() | viser.GuiSliderHandle():
            return lambda value: _is_number(value) and handle.min <= value <= handle.max
        case _:
            raise TypeError(f"no check for {type(handle).__name__}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
