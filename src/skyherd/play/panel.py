"""Controls beside the scene, and what the page says about the run.

Callbacks of controls run in threads of the server. They only ask the session for something.
"""

from collections import deque
from collections.abc import Callable, Sequence
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal

from skyherd.datasets import Mission
from skyherd.geometry import RgbImage
from skyherd.loop import Step
from skyherd.play.belief import BeliefChoice
from skyherd.play.buttons import Controls, ignoring_event
from skyherd.play.controls import Sliders, unit_quantities
from skyherd.play.curves import Curves
from skyherd.play.grab import Grab
from skyherd.play.messages import MessageFilter
from skyherd.play.pictures import LiveImage
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
from skyherd.play.sketch import Sketch
from skyherd.play.team_tab import TeamTab
from skyherd.play.wording import describe, escaped, state_line

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

EVENTS_SHOWN = 8
"""Events that are listed. Chosen: fit beside the curves."""

REFRESH_S = 0.4
"""Time between two updates of the sliders, s. Chosen: cheap, and soon after an undo."""


class Panel:
    """Controls and displays of one page.

    Args:
        server: server of the page.
        session: session that is asked.
        allowed: filter that must know each control.
        images: images of the units before their first frame.
    """

    def __init__(
        self,
        server: "viser.ViserServer",
        session: Session,
        allowed: MessageFilter,
        images: Sequence[RgbImage],
    ) -> None:
        self._gui, self._session = server.gui, session
        self._controls = Controls(server.gui, allowed)
        self._events: deque[str] = deque(maxlen=EVENTS_SHOWN)
        self._refreshed_s = 0.0
        self._notice = ""
        self._grab, self._sketch = Grab(server, session), Sketch(server, session)
        tabs = self._gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._add_transport()
            self._add_displays()
            self._add_saving()
        with tabs.add_tab("Cameras"):
            self._belief = BeliefChoice(self._controls, len(images))
            self._units: list[Sliders] = []
            self._lives: list[Any] = []
            self._pictures = [self._add_unit(unit, image) for unit, image in enumerate(images)]
        with tabs.add_tab("Team"):
            self._team = TeamTab(self._controls, session, self._grab, self._sketch)
        self._add_keys()

    @property
    def believer(self) -> int | None:
        """Unit whose knowledge is to be shown, or None."""
        return self._belief.unit

    def choose(self, choice: str) -> None:
        """Put the handle at `robot ID` or `unit NUMBER`; `nothing` hides it. Not while a shape is drawn."""
        if not self._sketch.is_on:
            self._team.choose(choice)

    def clear(self) -> None:
        """Forget the curves and events of the run before."""
        self._curves.clear()
        self._events.clear()
        self._notice = ""

    def notice(self, line: str) -> None:
        """Show a line of text until the next one, as text and not as Markdown."""
        self._notice = line

    def collect(self, step: Step) -> None:
        """Keep what the displays need of a step that is not shown."""
        self._curves.collect(step)
        for intervention in step.interventions:
            self._events.appendleft(f"{intervention.at_s:.1f} s: {describe(intervention)}")

    def show(self, step: Step, mission: Mission, images: Sequence[LiveImage]) -> None:
        """Show a step, which has been collected, of a mission with the interventions so far."""
        self._show_state(step, mission)
        self._curves.show()
        self._grab.show(step, mission)
        self._sketch.show(step)
        if monotonic() - self._refreshed_s > REFRESH_S:
            self._refreshed_s = monotonic()
            self._show_values(step, mission)
        for image in images:
            self._pictures[image.unit].image = image.titled

    def _show_values(self, step: Step, mission: Mission) -> None:
        """Show the present values of the sliders, and who is dead."""
        self._team.show_values(step, mission)
        for sliders in self._units:
            sliders.show(step, mission)
        dead = mission.scenario.dead_units(step.time_s)
        for unit, button in enumerate(self._lives):
            button.label = f"{'Revive' if unit in dead else 'Kill'} unit {unit}"

    def _show_state(self, step: Step, mission: Mission) -> None:
        """Show time, shape error and notices."""
        session = self._session
        self._pause.label = "Continue (P)" if session.is_paused else "Pause (P)"
        self._undo.disabled = not session.can_undo
        lines = [state_line(step, mission, "paused" if session.is_paused else "running")]
        self._state.content = "\n\n".join([*lines, *([f"`{escaped(self._notice)}`"] if self._notice else [])])
        self._list.content = "\n".join(f"- {escaped(event)}" for event in self._events) or "none yet"

    def _add_transport(self) -> None:
        gui, session, button = self._gui, self._session, self._controls.button
        self._state = gui.add_markdown("")
        self._pause = button("Pause (P)", lambda: session.ask(Pause(not session.is_paused)))
        button("Single step (N)", lambda: session.ask(SingleStep()))
        self._undo = button(
            "Undo (Z)", lambda: session.ask(Undo()), "restore what was before the last change"
        )
        speeds = dict(SPEEDS)
        if session.speed not in speeds.values():
            speeds[f"{session.speed:g} ×"] = session.speed
        now = next(name for name, factor in speeds.items() if factor == session.speed)
        hint = "simulated seconds in a second"
        self._speed = speed = self._controls.known(
            gui.add_dropdown("speed", list(speeds), initial_value=now, hint=hint)
        )
        speed.on_update(lambda _: session.ask(SetSpeed(speeds[speed.value])))

    def _add_displays(self) -> None:
        gui = self._gui
        self._curves = Curves(gui)
        with gui.add_folder("Interventions"):
            self._list = gui.add_markdown("none yet")

    def _add_saving(self) -> None:
        session, button = self._session, self._controls.button
        with self._gui.add_folder("Save and restart"):
            button(
                "Save as scenario (S)",
                lambda: session.ask(Save()),
                "in a new file, for `skyherd run`",
            )
            seed = self._controls.known(
                self._gui.add_number("seed", session.seed, min=0, max=MAX_SEED, step=1)
            )
            button("Restart (R)", lambda: session.ask(Restart(int(seed.value))), "without interventions")
        self._seed = seed

    def _add_unit(self, unit: int, image: RgbImage) -> "viser.GuiImageHandle":
        """Add the image and the controls of a unit; return the node of the image."""
        with self._gui.add_folder(f"unit {unit}"):
            node = self._gui.add_image(image, label=None, format="jpeg", jpeg_quality=80)
            with self._gui.add_folder(f"change unit {unit}", expand_by_default=False):
                quantities = unit_quantities(self._session.mission, unit)
                self._units.append(Sliders(self._controls, self._session, quantities, unit))
                self._lives.append(
                    self._controls.button(f"Kill unit {unit}", lambda: self._kill_or_revive(unit))
                )
        return node

    def _kill_or_revive(self, unit: int) -> None:
        kind = self._lives[unit].label.split()[0].lower()
        self._session.ask(Change(({"kind": kind, "unit": unit},)))

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
            self._gui.add_command(label, hotkey=key).on_trigger(ignoring_event(act))
