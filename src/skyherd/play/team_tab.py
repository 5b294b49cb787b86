"""Tab of the panel with what concerns the whole team: places, shape, markers, radio and gains."""

from collections.abc import Callable
from typing import Any

from skyherd.datasets import SHAPES, Mission
from skyherd.errors import InputError
from skyherd.loop import Step
from skyherd.play.buttons import Controls
from skyherd.play.controls import GAINS, RADIO, Quantity, Sliders
from skyherd.play.grab import Grab
from skyherd.play.session import Change, Session
from skyherd.play.sketch import Sketch
from skyherd.play.wording import escaped

SKETCH_HINTS = {
    False: "Draw a line on the ground. Its place and size are free.",
    True: "Click the corners of the line on the ground; click the first again to close it.",
}
"""Hints before and while a shape is drawn."""


class TeamTab:
    """Controls of the whole team. They are added to the container that is open.

    Args:
        controls: maker of controls.
        session: session that is asked.
        grab: handle in the scene.
        sketch: line that is drawn in the scene.
    """

    def __init__(self, controls: Controls, session: Session, grab: Grab, sketch: Sketch) -> None:
        self._controls, self._gui, self._session = controls, controls.gui, session
        self._add_move(grab)
        self._add_shape()
        self._sketch = sketch
        self._add_sketch()
        self._add_marker()
        self._sliders = self._add_sliders(session.mission)

    def show_values(self, step: Step, mission: Mission) -> None:
        """Show the present values of the sliders."""
        for sliders in self._sliders:
            sliders.show(step, mission)

    def _add_move(self, grab: Grab) -> None:
        """Add the choice of what the handle in the scene moves; a click on an object chooses it, too."""
        with self._gui.add_folder("Move"):
            hint = "or click on a robot or unit in the scene"
            chosen = self._controls.known(self._gui.add_dropdown("handle at", grab.choices, hint=hint))
            chosen.on_update(lambda _: grab.choose(chosen.value))
        self.choose: Callable[[str], None] = lambda choice: setattr(chosen, "value", choice)

    def _add_shape(self) -> None:
        ask = self._session.ask
        with self._gui.add_folder("Shape"):
            shape = self._controls.known(self._gui.add_dropdown("shape", sorted(SHAPES)))
            self._form = self._controls.button("Form the shape", lambda: ask(shape_change(shape.value)))
            hint = "letters that the robots write, such as SKY"
            word = self._controls.known(self._gui.add_text("word", "", hint=hint))
            self._write = self._controls.button("Write the word", lambda: ask(word_change(word.value)))
            self._word = word

    def _add_sketch(self) -> None:
        with self._gui.add_folder("Draw a shape"):
            self._hint = self._gui.add_markdown(SKETCH_HINTS[False])
            self._draw = self._controls.button("Draw", self._begin_or_end_sketch)
            self._form_drawn = self._controls.button("Form the drawn shape", self._form_sketch)
            self._form_drawn.disabled = True

    def _begin_or_end_sketch(self) -> None:
        (self._sketch.end if self._sketch.is_on else self._sketch.begin)()
        self._show_sketch()

    def _form_sketch(self) -> None:
        try:
            self._sketch.form()
        except InputError as error:
            self._hint.content = escaped(str(error))
        else:
            self._show_sketch()

    def _show_sketch(self) -> None:
        is_on = self._sketch.is_on
        self._hint.content = SKETCH_HINTS[is_on]
        self._draw.label = "Discard" if is_on else "Draw"
        self._form_drawn.disabled = not is_on

    def _add_marker(self) -> None:
        ask, mission = self._session.ask, self._session.mission
        markers = [str(marker) for marker in (*mission.ids.tolist(), *mission.obstacle_ids.tolist())]
        with self._gui.add_folder("Cover a marker"):
            marker: Any = self._controls.known(self._gui.add_dropdown("marker", markers))
            self._cover = self._controls.button("Cover", lambda: ask(cover_change(marker.value, True)))
            self._uncover = self._controls.button("Uncover", lambda: ask(cover_change(marker.value, False)))

    def _add_sliders(self, mission: Mission) -> list[Sliders]:
        control = mission.scenario.control
        groups: dict[str, tuple[Quantity, ...]] = {"Radio": RADIO}
        if control.method == "similarity":
            groups["Gains"] = GAINS[control.gains]
        added = []
        for title, quantities in groups.items():
            with self._gui.add_folder(title):
                added.append(Sliders(self._controls, self._session, quantities))
        return added


def shape_change(shape: str) -> Change:
    """Return the request for a named shape or a word."""
    return Change(({"kind": "template", "shape": shape},))


def word_change(word: str) -> Change:
    """Return the request for a word, in capitals."""
    return shape_change(f"word:{word.upper()}")


def cover_change(marker: str, covered: bool) -> Change:
    """Return the request to cover or uncover a marker."""
    return Change(({"kind": "cover", "marker": int(marker), "covered": covered},))
