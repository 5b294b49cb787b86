"""Controls whose values become interventions: sliders of cameras, units, radio and gains.

A slider shows the present value, also after undo, a restart or the flight of a unit, except while it is being
dragged.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any

from skyherd.datasets import Mission
from skyherd.loop import Step
from skyherd.play.buttons import Controls
from skyherd.play.changes import Table, camera_values, unit_values
from skyherd.play.session import Change, Session

if TYPE_CHECKING:
    import viser

TOUCH_S = 1.5
"""Time after a touch for which a slider is not set to the present value, s. Chosen: a short hesitation."""


@dataclass(frozen=True)
class Quantity:
    """One number that an operator may change.

    Attributes:
        label: name and unit on the page.
        kind: kind of the intervention.
        key: its key.
        low: least value of the slider; a scenario with a smaller one extends it.
        high: greatest value, in the same way.
        step: resolution of the slider.
        part: index or key of the number within the value; None if the value is the number.
        hint: explanation that is shown when the pointer rests on it.
    """

    label: str
    kind: str
    key: str
    low: float
    high: float
    step: float
    part: int | str | None = None
    hint: str | None = None

    def of(self, value: Any) -> float:
        """Return the number within a value."""
        return float(value if self.part is None else value[self.part])

    def changed(self, value: Any, number: float) -> Any:
        """Return a value with another number in it."""
        match self.part:
            case None:
                return number
            case int():
                return [number if index == self.part else one for index, one in enumerate(value)]
            case _:
                return {**value, self.part: number}


CAMERA = (
    Quantity("zoom", "camera", "zoom", 0.5, 2.5, 0.01, hint="factor on the focal length"),
    Quantity("yaw, °", "unit", "yaw_deg", -180, 180, 1, hint="direction of the image's right side"),
    Quantity("tilt about u, °", "unit", "tilt_deg", -30, 30, 0.5, part=0),
    Quantity("tilt about v, °", "unit", "tilt_deg", -30, 30, 0.5, part=1),
    Quantity("lens bend k1", "camera", "distortion", -0.3, 0.3, 0.01, part="k1", hint="negative: barrel"),
    Quantity("pixel aspect", "camera", "aspect", 0.8, 1.25, 0.01, hint="1 for square pixels"),
    Quantity("blur, px", "camera", "psf_px", 0.3, 4, 0.1),
    Quantity("noise, grey levels", "camera", "noise", 0, 40, 0.5),
    Quantity("exposure, s", "camera", "exposure_s", 0, 0.05, 0.001, hint="blurs what moves in the image"),
    Quantity("gain", "camera", "gain", 0.2, 3, 0.05, hint="brightness"),
    Quantity("lost images", "camera", "frame_loss", 0, 1, 0.01, hint="share of the images"),
)
"""Numbers of a unit and its camera, besides the height, whose limits the scenario has."""

RADIO = (
    Quantity("lost messages", "network", "message_loss", 0, 0.95, 0.01, hint="share of the messages"),
    Quantity("delay, s", "network", "delay_s", 0, 2, 0.01, hint="largest delay of a message"),
)
"""Numbers of the radio."""

GAINS = {
    "marker": (
        Quantity("k, 1/s", "control", "k", 0.01, 1, 0.01, hint="speed for each metre to the goal"),
        Quantity("k_omega, 1/s", "control", "k_omega", 0.05, 3, 0.05, hint="turn rate for each radian"),
        Quantity("b_th, sides", "control", "b_th", 0, 0.5, 0.005, hint="robots nearer to their goal stop"),
    ),
    "pixel": (
        Quantity("k_v, m/s/px", "control", "k_v", 0.0001, 0.01, 0.0001, hint="speed for each pixel"),
        Quantity("k_omega, 1/s", "control", "k_omega", 0.05, 3, 0.05, hint="turn rate for each radian"),
        Quantity("b_th, px", "control", "b_th", 0, 10, 0.1, hint="robots nearer to their goal stop"),
    ),
}
"""Gains of the robots, by the key `control.gains`."""


def unit_quantities(mission: Mission, unit: int) -> Iterator[Quantity]:
    """Yield the numbers of a unit and its camera that can be changed."""
    scenario = mission.scenario
    model, limits = scenario.units[unit], scenario.autopilot
    high_m = min(limits.max_height_m, 3 * model.height_m)
    yield Quantity("height, m", "unit", "height_m", limits.min_height_m, high_m, 0.1)
    for quantity in CAMERA:
        if quantity.key != "distortion" or model.camera.lens == "perspective":
            yield quantity


def present_values(mission: Mission, step: Step, unit: int | None) -> Mapping[str, Any]:
    """Return the present values by key: of a unit and its camera, or of radio and gains without one."""
    if unit is not None:
        return unit_values(mission, step, unit) | camera_values(mission, step, unit)
    scenario = mission.scenario_at(step.time_s)
    return scenario.network.model_dump() | scenario.control.model_dump()


class Slider:
    """A slider of one number."""

    def __init__(
        self,
        controls: Controls,
        quantity: Quantity,
        number: float,
        on_change: Callable[[Quantity, float], None],
    ) -> None:
        self.quantity, self._touched_s = quantity, -TOUCH_S
        self._node: Any = controls.known(
            controls.gui.add_slider(
                quantity.label,
                min=float(min(quantity.low, number)),
                max=float(max(quantity.high, number)),
                step=quantity.step,
                initial_value=float(number),
                hint=quantity.hint,
            )
        )

        def moved(event: "viser.GuiEvent[Any]") -> None:
            if event.client is not None:  # otherwise the value comes from `show`
                self._touched_s = monotonic()
                on_change(quantity, float(self._node.value))

        self._node.on_update(moved)

    def show(self, number: float) -> None:
        """Show the present value, unless the slider is being dragged."""
        if (
            monotonic() - self._touched_s >= TOUCH_S
            and abs(number - self._node.value) > self.quantity.step / 2
        ):
            self._node.value = min(max(number, self._node.min), self._node.max)


class Sliders:
    """Sliders of one unit, or of radio and gains.

    Args:
        controls: maker of controls.
        session: session that is asked.
        quantities: the numbers.
        unit: the unit, or None.
    """

    def __init__(
        self,
        controls: Controls,
        session: Session,
        quantities: Iterator[Quantity] | tuple[Quantity, ...],
        unit: int | None = None,
    ) -> None:
        self._session, self._unit = session, unit
        self._values: Mapping[str, Any] = start_values(session.mission, unit)
        self._sliders = [
            Slider(controls, one, one.of(self._values[one.key]), self._ask) for one in quantities
        ]

    def show(self, step: Step, mission: Mission) -> None:
        """Show the present values."""
        self._values = present_values(mission, step, self._unit)
        for slider in self._sliders:
            slider.show(slider.quantity.of(self._values[slider.quantity.key]))

    def _ask(self, quantity: Quantity, number: float) -> None:
        value = quantity.changed(self._values[quantity.key], number)
        table: Table = {"kind": quantity.kind, quantity.key: value}
        self._session.ask(Change(({**table, "unit": self._unit} if self._unit is not None else table,)))


def start_values(mission: Mission, unit: int | None) -> Mapping[str, Any]:
    """Return the values at the start of a mission, as `present_values` does for a step."""
    scenario = mission.scenario
    if unit is None:
        return scenario.network.model_dump() | scenario.control.model_dump()
    model, sensor = scenario.units[unit], scenario.sensor.model_dump()
    own = model.model_dump(include={"height_m", "yaw_deg", "tilt_deg"})
    camera = model.camera.model_dump(include={"distortion", "aspect"})
    return {**sensor, **own, **camera, "zoom": model.zoom[0][1], "frame_loss": scenario.network.frame_loss}
