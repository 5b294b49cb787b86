"""Controls beside the scene, and what the page says about the run.

Callbacks of controls run in threads of the server. They only ask the session for something.
"""

from collections import deque
from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from skyherd.analysis.goal_points import outline_px
from skyherd.control import ControlSets
from skyherd.datasets import SHAPES, Intervention, Mission
from skyherd.drawing.palette import INK, TEMPLATE_COLOR
from skyherd.geometry import Array
from skyherd.loop import Step, UnitFrame
from skyherd.play.controls import GAINS, RADIO, Sliders, unit_quantities
from skyherd.play.grab import Grab
from skyherd.play.messages import MessageFilter
from skyherd.play.session import (
    Change,
    Pause,
    Restart,
    Save,
    Session,
    SetSpeed,
    SingleStep,
    Undo,
)
from skyherd.video.body_overlay import BodySizes
from skyherd.video.camera_panel import TITLE_PX, CameraPanel

if TYPE_CHECKING:
    import viser

Key = Literal["P", "N", "Z", "S", "R"]
"""Keys of the keyboard with an effect."""

SPEEDS: dict[str, float | None] = {
    "0.25 ×": 0.25,
    "0.5 ×": 0.5,
    "1 ×": 1.0,
    "2 ×": 2.0,
    "4 ×": 4.0,
    "as fast as possible": None,
}
"""Speeds to choose from, in simulated seconds a second."""

MAX_SEED = 2**31 - 1
"""Greatest seed that can be typed. Chosen: exact in JavaScript."""

CURVE_POINTS = 400
"""Points of the curves. Chosen: one for each pixel of the panel."""

MIN_SHOWN = 1e-5
"""Smallest value in the curves with their logarithmic axis. Chosen: far below any goal."""

EVENTS_SHOWN = 8
"""Events that are listed. Chosen: fit beside the curves."""

REFRESH_S = 0.4
"""Time between two updates of the sliders, s. Chosen: cheap, and soon after an undo."""

BUTTON = (33, 84, 140)
"""Colour of buttons. Chosen: white text on it has a contrast of 7.6, above the 4.5 of WCAG AA."""

PICTURE_PX = 400
"""Width of a unit's image in the panel, px. Chosen: the width of the panel on a laptop."""


class Panel:
    """Controls and displays of one page.

    Args:
        server: server of the page.
        session: session that is asked.
        allowed: filter that must know each control.
    """

    def __init__(self, server: "viser.ViserServer", session: Session, allowed: MessageFilter) -> None:
        self._gui, self._session, self._allowed = server.gui, session, allowed
        mission = session.mission
        self._times_s: deque[float] = deque()
        self._curves: deque[tuple[float, float]] = deque()
        self._events: deque[str] = deque(maxlen=EVENTS_SHOWN)
        self._refreshed_s = 0.0
        self._grab = Grab(server, session)
        self._frames: dict[int, UnitFrame] = {}
        self._notice = ""
        tabs = self._gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._add_transport()
            self._add_displays()
        with tabs.add_tab("Cameras"):
            self._units: list[Sliders] = []
            self._lives: list[viser.GuiButtonHandle] = []
            self._pictures = [self._add_picture(mission, unit) for unit in range(len(mission.scenario.units))]
        with tabs.add_tab("Team"):
            self._add_move()
            self._add_shape()
            self._add_marker()
            self._team = self._add_team(mission)
        self._add_keys()

    @property
    def has_images(self) -> bool:
        """True if a new image waits; each drawing takes one, so that none takes long."""
        return bool(self._frames)

    def clear(self) -> None:
        """Forget the curves and events of the run before."""
        self._times_s.clear()
        self._curves.clear()
        self._events.clear()
        self._frames.clear()
        self._notice = ""

    def notice(self, line: str) -> None:
        """Show a line of text until the next one, as text and not as Markdown."""
        self._notice = line

    def collect(self, step: Step) -> None:
        """Keep what the displays need of a step that is not shown."""
        self._frames |= step.frames
        self._times_s.append(step.time_s)
        self._curves.append((step.metrics.shape.error, step.metrics.V))
        if len(self._times_s) > 2 * CURVE_POINTS:
            self._times_s = deque(list(self._times_s)[::2])
            self._curves = deque(list(self._curves)[::2])
        for intervention in step.interventions:
            self._events.appendleft(f"{intervention.at_s:.1f} s: {describe(intervention)}")

    def show(self, step: Step, mission: Mission) -> None:
        """Show a step, which has been collected, of a mission with the interventions so far."""
        self._show_state(step, mission)
        values = np.maximum(np.array(self._curves), MIN_SHOWN)
        self._plot.data = (np.array(self._times_s), values[:, 0], values[:, 1])
        self._grab.show(step, mission)
        dead = mission.scenario.dead_units(step.time_s)
        if monotonic() - self._refreshed_s > REFRESH_S:
            self._refreshed_s = monotonic()
            for sliders in (*self._team, *self._units):
                sliders.show(step, mission)
            for unit, button in enumerate(self._lives):
                button.label = f"{'Revive' if unit in dead else 'Kill'} unit {unit}"
        for unit in dead:
            self._frames.pop(unit, None)
            self._pictures[unit].show_dead()
        if self._frames:
            unit = next(iter(self._frames))
            self._pictures[unit].show(self._frames.pop(unit), step, mission)

    def _show_state(self, step: Step, mission: Mission) -> None:
        """Show time, shape error and notices."""
        session = self._session
        self._pause.label = "Continue (P)" if session.is_paused else "Pause (P)"
        self._undo.disabled = not session.can_undo
        error = step.metrics.shape.error
        state = "paused" if session.is_paused else "running"
        reached = " · **shape reached**" if error < mission.scenario.goal.shape_error else ""
        lines = [f"**{step.time_s:.1f} s** · {state} · shape error **{100 * error:.2g} %**{reached}"]
        self._state.content = "\n\n".join([*lines, *([f"`{escaped(self._notice)}`"] if self._notice else [])])
        self._list.content = "\n".join(f"- {escaped(event)}" for event in self._events) or "none yet"

    def _add_transport(self) -> None:
        gui, session = self._gui, self._session
        self._state = gui.add_markdown("")
        self._pause = self._button("Pause (P)", lambda: session.ask(Pause(not session.is_paused)))
        self._button("Single step (N)", lambda: session.ask(SingleStep()))
        names = list(SPEEDS)
        now = next(name for name, factor in SPEEDS.items() if factor == session.speed)
        self._speed = speed = gui.add_dropdown(
            "speed", names, initial_value=now, hint="simulated seconds in a second"
        )
        self._known(speed).on_update(lambda _: session.ask(SetSpeed(SPEEDS[speed.value])))
        self._undo = self._button("Undo (Z)", lambda: session.ask(Undo()))
        self._button("Save as scenario (S)", lambda: session.ask(Save()))
        seed = gui.add_number("seed", session.seed, min=0, max=MAX_SEED, step=1)
        self._known(seed)
        self._button("Restart (R)", lambda: session.ask(Restart(int(seed.value))))
        self._seed = seed

    def _add_displays(self) -> None:
        gui = self._gui
        empty = np.array([0.0, 1.0])
        self._plot = gui.add_uplot(
            (empty, empty, empty),
            (
                {"label": "time, s"},
                {"label": "shape error", "stroke": TEMPLATE_COLOR, "width": 2},
                {"label": "cost V, m²", "stroke": INK, "width": 2, "dash": (6, 4)},
            ),
            scales={"x": {"time": False}, "y": {"distr": 3, "log": 10}},
            height=210,
            padding=(8, 24, 0, 0),
        )
        with gui.add_folder("Interventions"):
            self._list = gui.add_markdown("none yet")

    def _add_picture(self, mission: Mission, unit: int) -> "UnitPicture":
        with self._gui.add_folder(f"unit {unit}"):
            picture = UnitPicture(self._gui, mission, unit)
            with self._gui.add_folder(f"change unit {unit}", expand_by_default=unit == 0):
                quantities = unit_quantities(mission, unit)
                self._units.append(Sliders(self._gui, self._allowed, self._session, quantities, unit))
                self._lives.append(self._button(f"Kill unit {unit}", lambda: self._kill_or_revive(unit)))
        return picture

    def _kill_or_revive(self, unit: int) -> None:
        kind = self._lives[unit].label.split()[0].lower()
        self._session.ask(Change(({"kind": kind, "unit": unit},)))

    def _add_move(self) -> None:
        """Add the choice of what the handle in the scene moves; a click on an object chooses it, too."""
        with self._gui.add_folder("Move"):
            chosen = self._gui.add_dropdown(
                "handle at", self._grab.choices, hint="or click on it in the scene"
            )
            self._known(chosen).on_update(lambda _: self._grab.choose(chosen.value))
        self.choose: Callable[[str], None] = lambda choice: setattr(chosen, "value", choice)

    def _add_shape(self) -> None:
        gui, session = self._gui, self._session
        with gui.add_folder("Shape"):
            shape = self._known(gui.add_dropdown("shape", sorted(SHAPES)))
            self._form = self._button("Form the shape", lambda: session.ask(shape_change(shape.value)))
            word = self._known(gui.add_text("word", "", hint="letters that the robots write, such as SKY"))
            self._write = self._button("Write the word", lambda: session.ask(word_change(word.value)))
            self._word = word

    def _add_marker(self) -> None:
        gui, session = self._gui, self._session
        mission = session.mission
        markers = [str(marker) for marker in (*mission.ids.tolist(), *mission.obstacle_ids.tolist())]
        with gui.add_folder("Cover a marker"):
            marker = self._known(gui.add_dropdown("marker", markers))
            self._cover = self._button("Cover", lambda: session.ask(cover_change(marker.value)))
            self._uncover = self._button("Uncover", lambda: session.ask(uncover_change(marker.value)))

    def _add_team(self, mission: Mission) -> list[Sliders]:
        added = []
        gains = GAINS[mission.scenario.control.gains]
        for title, quantities in (("Radio", RADIO), ("Gains", gains)):
            if title == "Radio" or mission.scenario.control.method == "similarity":
                with self._gui.add_folder(title):
                    added.append(Sliders(self._gui, self._allowed, self._session, quantities))
        return added

    def _add_keys(self) -> None:
        session = self._session
        keys: tuple[tuple[Key, str, Callable[[], None]], ...] = (
            ("P", "Pause or continue", lambda: session.ask(Pause(not session.is_paused))),
            ("N", "Single step", lambda: session.ask(SingleStep())),
            ("Z", "Undo", lambda: session.ask(Undo())),
            ("S", "Save as scenario", lambda: session.ask(Save())),
            ("R", "Restart", lambda: session.ask(Restart(int(self._seed.value)))),
        )
        for key, label, act in keys:
            self._gui.add_command(label, hotkey=key).on_trigger(_ignoring_event(act))

    def _button(self, label: str, act: Callable[[], None]) -> "viser.GuiButtonHandle":
        button = self._gui.add_button(label, color=BUTTON)
        button.on_click(_ignoring_event(act))
        self._allowed.register(button)
        return button

    def _known(self, handle: Any) -> Any:
        """Register a control with the filter of messages, and return it."""
        self._allowed.register(handle)
        return handle


def shape_change(shape: str) -> Change:
    """Return the request for a named shape or a word."""
    return Change(({"kind": "template", "shape": shape},))


def word_change(word: str) -> Change:
    """Return the request for a word, in capitals."""
    return shape_change(f"word:{word.upper()}")


def cover_change(marker: str) -> Change:
    """Return the request to cover a marker."""
    return Change(({"kind": "cover", "marker": int(marker)},))


def uncover_change(marker: str) -> Change:
    """Return the request to uncover a marker."""
    return Change(({"kind": "cover", "marker": int(marker), "covered": False},))


def _ignoring_event(act: Callable[[], None]) -> Callable[[object], None]:
    """Return a function that ignores the event which it is called with."""
    return lambda event: act()


class UnitPicture:
    """Image of one unit in the panel, with its detections, goals and the shape as the unit sees it."""

    def __init__(self, gui: "viser.GuiApi", mission: Mission, unit: int) -> None:
        self._unit = unit
        size_px = mission.scenario.units[unit].camera.size_px
        height_px = TITLE_PX + round(PICTURE_PX * size_px[1] / size_px[0])
        self._canvas = np.full((height_px, PICTURE_PX, 3), 255, np.uint8)
        radius, sizes = mission.scenario.selection.radius, BodySizes.of(mission)
        self._panel = CameraPanel(unit, self._canvas, size_px, radius, sizes)
        self._node = gui.add_image(self._canvas, label=None, format="jpeg", jpeg_quality=80)

    def show(self, frame: UnitFrame, step: Step, mission: Mission) -> None:
        """Show an image and the unit's decision."""
        shape = mission.shape_at(step.time_s, step.roles)
        lines: list[Array] = outline_px(frame.decision, shape, mission.outline_at(step.time_s))
        sets: ControlSets = step.control_sets
        self._panel.draw(frame, sets, outline_px=lines)
        self._node.image = self._canvas

    def show_dead(self) -> None:
        """Show that the unit is dead."""
        self._panel.draw_dead()
        self._node.image = self._canvas


def describe(intervention: Intervention) -> str:
    """Return an intervention in a few words."""
    given = intervention.model_dump(mode="json", exclude_none=True)
    kind = given.pop("kind")
    del given["at_s"]
    target = next((f" {key} {given.pop(key)}" for key in ("unit", "robot", "marker") if key in given), "")
    names = ", ".join(f"{key} {shown(value)}" for key, value in given.items())
    return f"{kind}{target if kind not in target else target.removeprefix(f' {kind}')} {names}".strip()


def shown(value: Any) -> str:
    """Return a value as short text."""
    if isinstance(value, list):
        return f"({', '.join(map(shown, value))})" if len(value) < 4 else f"{len(value)} items"
    if isinstance(value, dict):
        return " ".join(f"{key} {shown(one)}" for key, one in value.items() if one)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def escaped(text: str) -> str:
    """Return a text without characters that Markdown would read as markup."""
    return "".join(" " if character in "`*_<>[]|\\#$!~\n" else character for character in text)
