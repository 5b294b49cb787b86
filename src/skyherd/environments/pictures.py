"""Pictures of an environment: the ground from above, or the last image of a unit."""

from typing import Protocol

import numpy as np

from skyherd.datasets import Mission
from skyherd.drawing.palette import PAPER, rgb
from skyherd.errors import InputError
from skyherd.geometry import RgbImage
from skyherd.loop import Step
from skyherd.video.body_overlay import overlapping_ids
from skyherd.video.ground_panel import GroundPanel

GROUND = "ground"
"""Name of the picture of the ground from above."""

GROUND_SIZE_PX = (640, 640)
"""Width and height of the picture of the ground, px. Chosen: names of sixteen robots are legible."""


class Picture(Protocol):
    """Interface of a picture that is drawn at each step."""

    def draw(self, step: Step) -> None:
        """Draw the next step."""
        ...

    @property
    def image(self) -> RgbImage:
        """The picture (height, width, 3) of the last step, a copy."""
        ...


class GroundPicture(Picture):
    """The ground from above, with the true positions of robots and units and the best-fitting shape."""

    def __init__(self, mission: Mission) -> None:
        width, height = GROUND_SIZE_PX
        self._mission, self._canvas = mission, np.empty((height, width, 3), np.uint8)
        self._canvas[:] = rgb(PAPER)
        self._panel = GroundPanel(mission, self._canvas)

    def draw(self, step: Step) -> None:
        """Draw the ground at the next step."""
        self._panel.draw(step, struck=overlapping_ids(self._mission, step.positions_m))

    @property
    def image(self) -> RgbImage:
        """The picture of the last step."""
        return self._canvas.copy()


class UnitPicture(Picture):
    """The last image of a unit; black before the first one."""

    def __init__(self, mission: Mission, unit: int) -> None:
        width, height = mission.scenario.units[unit].camera.size_px
        self._unit, self._image = unit, np.zeros((height, width), np.uint8)

    def draw(self, step: Step) -> None:
        """Keep the image of the next step, if the unit took one."""
        frame = step.frames.get(self._unit)
        if frame is not None and frame.sight.image is not None:
            self._image = frame.sight.image

    @property
    def image(self) -> RgbImage:
        """The last image, grey in three channels."""
        return np.repeat(self._image[..., None], 3, axis=2)


def make_picture(mission: Mission, view: str) -> Picture:
    """Make the picture of a view, `ground` or `unit_J`.

    Raises:
        InputError: there is no such view, or the scenario renders no images.
    """
    units = [f"unit_{unit}" for unit in range(len(mission.scenario.units))]
    if view == GROUND:
        return GroundPicture(mission)
    if view not in units:
        raise InputError("FormationEnv: view", repr(view), f"one of {', '.join([GROUND, *units])}")
    if mission.scenario.perception != "rendered":
        what = f"no images with perception {mission.scenario.perception}"
        raise InputError(f"FormationEnv: view {view}", what, "perception = rendered, or the view ground")
    return UnitPicture(mission, units.index(view))
