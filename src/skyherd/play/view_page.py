"""The page of a recorded run: the scene at any time, with a time bar.

The thread of `ViewPage.run` owns the scene, the panel and the time. Browsers only put requests into a queue.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from socket import socket
from time import monotonic
from typing import TYPE_CHECKING, Any

from skyherd.datasets import Mission
from skyherd.loop import Step
from skyherd.play.belief import BeliefChoice
from skyherd.play.buttons import Controls, ignoring_event
from skyherd.play.controls import TOUCH_S
from skyherd.play.curves import Curves
from skyherd.play.messages import MessageFilter
from skyherd.play.panel import SPEEDS
from skyherd.play.pictures import LiveImage
from skyherd.play.replay import Replay
from skyherd.play.server import start_server, stop_server
from skyherd.play.session import End, SetSpeed
from skyherd.play.wording import describe, escaped, state_line
from skyherd.report.access import Access

if TYPE_CHECKING:
    import viser

INTERVAL_S = 0.1
"""Time between two drawings, s. Chosen: that of most recordings' steps."""

EVENTS_S = 20.0
"""Time for which interventions are listed, s. Chosen: they can be read at four times the speed."""

VIEW_SPEEDS = {name: factor for name, factor in SPEEDS.items() if factor is not None}
"""Speeds to choose from."""


@dataclass(frozen=True)
class PlayOrPause:
    """Request to go on or stand still; at the end, to begin again."""


@dataclass(frozen=True)
class Seek:
    """Request to go to a time, s."""

    time_s: float


class ViewPage:
    """A page on which a recorded run is shown.

    Attributes:
        access: rules for connections, with the page's address.
        server: viser's server.
        time_s: time that is shown.
        is_paused: whether it stands still.
        speed: recorded seconds a second.

    Args:
        mission: the mission.
        steps: all steps, in the order of time.
        access: as the attribute.
        listener: bound socket of the server.
    """

    def __init__(self, mission: Mission, steps: Sequence[Step], access: Access, listener: socket) -> None:
        self.access = access
        self._requests: SimpleQueue[PlayOrPause | Seek | SetSpeed | End] = SimpleQueue()
        allowed = MessageFilter()
        self.server = start_server(access, listener, allowed)
        self._replay = Replay(self.server, mission, steps)
        self.time_s, self.is_paused, self.speed = steps[0].time_s, False, 1.0
        self._index, self._is_ended = -1, False
        self._sought_s = -TOUCH_S
        self._add_panel(Controls(self.server.gui, allowed))

    def ask(self, request: PlayOrPause | Seek | SetSpeed | End) -> None:
        """Ask for something; may be called from any thread, and returns at once."""
        self._requests.put(request)

    def close(self) -> None:
        """Close the page and all connections."""
        stop_server(self.server)

    def run(self) -> None:
        """Show the run until the request `End`."""
        began_s = monotonic()
        while not self._is_ended:
            self._draw()
            self._handle(INTERVAL_S)
            elapsed_s, began_s = monotonic() - began_s, monotonic()
            if not self.is_paused:
                self.time_s = min(self._replay.end_s, self.time_s + self.speed * elapsed_s)
                self.is_paused = self.time_s >= self._replay.end_s

    def _handle(self, wait_s: float) -> None:
        """Carry out the requests of a time, s."""
        due_s = monotonic() + wait_s
        while (left_s := due_s - monotonic()) > 0 and not self._is_ended:
            try:
                request = self._requests.get(timeout=left_s)
            except Empty:
                return
            match request:
                case PlayOrPause():
                    if self.is_paused and self.time_s >= self._replay.end_s:
                        self.time_s = self._replay.steps[0].time_s
                    self.is_paused = not self.is_paused
                case Seek():
                    self.time_s, self._sought_s = min(request.time_s, self._replay.end_s), monotonic()
                case SetSpeed():
                    self.speed = request.factor or 1.0
                case End():
                    self._is_ended = True

    def _draw(self) -> None:
        """Draw the step at the present time, if it is another one, and the state."""
        index = self._replay.index_at(self.time_s)
        step, mission = self._replay.steps[index], self._replay.mission
        images: list[LiveImage] = []
        scene, believer = self._replay.scene, self._belief.unit
        if index != self._index or believer != scene.believer:
            self._index, scene.believer = index, believer
            images = self._replay.draw(index)
        self._state.content = state_line(step, mission, "paused" if self.is_paused else "playing")
        self._button.label = "Play (P)" if self.is_paused else "Pause (P)"
        if monotonic() - self._sought_s > TOUCH_S:
            self._bar.value = min(max(round(self.time_s, 1), self._bar.min), self._bar.max)
        events = [
            f"- {one.at_s:.1f} s: {escaped(describe(one))}"
            for one in mission.scenario.interventions_in_order
            if step.time_s - EVENTS_S <= one.at_s <= step.time_s
        ]
        self._events.content = "\n".join(reversed(events)) or "none in the last 20 s"
        for image in images:
            self._pictures[image.unit].image = image.titled

    def _seek(self, event: "viser.GuiEvent[Any]") -> None:
        """Ask for the time of the bar, if a browser has moved it."""
        if event.client is not None:
            self.ask(Seek(float(self._bar.value)))

    def _add_panel(self, controls: Controls) -> None:
        gui, steps = controls.gui, self._replay.steps
        self._state = gui.add_markdown("")
        self._button: Any = controls.button("Pause (P)", lambda: self.ask(PlayOrPause()))
        play_or_pause = ignoring_event(lambda: self.ask(PlayOrPause()))
        gui.add_command("Play or pause", hotkey="P").on_trigger(play_or_pause)
        first_s, last_s = steps[0].time_s, max(self._replay.end_s, steps[0].time_s + 0.1)
        self._bar: Any = controls.known(
            gui.add_slider("time, s", min=first_s, max=last_s, step=0.1, initial_value=first_s)
        )
        self._bar.on_update(self._seek)
        speed = controls.known(gui.add_dropdown("speed", list(VIEW_SPEEDS), initial_value="1 ×"))
        speed.on_update(lambda _: self.ask(SetSpeed(VIEW_SPEEDS[speed.value])))
        self._belief = BeliefChoice(controls, len(self._replay.mission.scenario.units))
        curves = Curves(gui)
        for step in steps:
            curves.collect(step)
        curves.show()
        with gui.add_folder("Interventions"):
            self._events = gui.add_markdown("")
        self._pictures = []
        for unit, image in enumerate(self._replay.images.first):
            with gui.add_folder(f"unit {unit}", expand_by_default=unit == 0):
                self._pictures.append(gui.add_image(image, label=None, format="jpeg", jpeg_quality=80))
