"""Pictures of the scene: ground, marker cards, and the units' live images."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from skyherd.analysis.goal_points import outline_px
from skyherd.datasets import Mission
from skyherd.geometry import Array, RgbImage
from skyherd.loop import Step, UnitFrame
from skyherd.markers.dictionary import QUIET_ZONE_CELLS, marker_cells
from skyherd.video.body_overlay import BodySizes
from skyherd.video.camera_panel import TITLE_PX, CameraPanel

GROUND_PX = 1024
"""Resolution of the ground's picture, px. Chosen: 6 cm a pixel in the scenario `star`, 0.2 MB as JPEG."""

GROUND_SPANS = 2.5
"""Side of the ground over the extent of robots and units. Chosen: robots can be dragged outside."""

PALE = 0.45
"""Share of the ground's contrast and darkness that is shown. Chosen: coloured lines stay legible on it."""

LIVE_PX = 400
"""Width of a unit's image, px. Chosen: the width of the panel on a laptop."""

SMALL_PX = 240
"""Width of a unit's image in a file, px. Chosen: the width that it has in the scene on a laptop."""

CHANGED_LEVELS, CHANGED_SHARE = 64, 0.002
"""Grey levels by which a value has changed, and the share of such values in an image that has. Chosen: a
robot that moves by two pixels of the small image."""


def ground_picture(mission: Mission) -> tuple[RgbImage, Array, float]:
    """Return the ground as a picture from above, the centre (2,) and the side of what it shows, m."""
    scenario = mission.scenario
    units_m = np.array([unit.position_m for unit in scenario.units])
    places_m = np.concatenate([mission.positions_m, units_m, mission.obstacle_positions_m])
    low, high = places_m.min(axis=0), places_m.max(axis=0)
    heights_m = max(unit.height_m for unit in scenario.units)
    center_m, side_m = (low + high) / 2, GROUND_SPANS * max(float(np.ptp(places_m, axis=0).max()), heights_m)
    ground = scenario.ground.make(scenario.seed, psf_px=scenario.sensor.psf_px, image=mission.ground_image)
    scale = GROUND_PX / side_m
    x, y = center_m.tolist()
    middle = (GROUND_PX - 1) / 2
    homography = np.array([[scale, 0.0, middle - scale * x], [0.0, -scale, middle + scale * y], [0, 0, 1.0]])
    grey = ground.draw(homography, (GROUND_PX, GROUND_PX)).astype(float)
    pale = np.clip(255 - PALE * (255 - grey), 0, 255).astype(np.uint8)
    return np.repeat(pale[..., None], 3, axis=2), center_m, side_m


def marker_picture(dictionary: str, marker_id: int, pixels: int = 8) -> RgbImage:
    """Return the card of a marker: its cells, `pixels` px wide, inside a white margin."""
    margin = round(QUIET_ZONE_CELLS * pixels)
    cells = np.kron(marker_cells(dictionary, marker_id), np.ones((pixels, pixels), dtype=bool))
    grey = np.pad(np.where(cells, 255, 0).astype(np.uint8), margin, constant_values=255)
    return np.repeat(grey[..., None], 3, axis=2)


@dataclass(frozen=True)
class LiveImage:
    """Image of one unit with its detections, goals and the shape as the unit sees it.

    Attributes:
        unit: number of the unit.
        titled: the image below a title.
        plain: the image alone.
    """

    unit: int
    titled: RgbImage
    plain: RgbImage


class LiveImages:
    """Drawing of the units' newest images.

    Args:
        mission: mission at its start.
    """

    def __init__(self, mission: Mission) -> None:
        self._frames: dict[int, UnitFrame] = {}
        self._dead: frozenset[int] = frozenset()
        sizes, radius = BodySizes.of(mission), mission.scenario.selection.radius
        self._canvases: list[RgbImage] = []
        self._panels: list[CameraPanel] = []
        for unit, model in enumerate(mission.scenario.units):
            width, height = model.camera.size_px
            canvas = np.full((TITLE_PX + round(LIVE_PX * height / width), LIVE_PX, 3), 255, np.uint8)
            self._canvases.append(canvas)
            self._panels.append(CameraPanel(unit, canvas, (width, height), radius, sizes))

    @property
    def is_waiting(self) -> bool:
        """True if an image waits to be drawn."""
        return bool(self._frames)

    @property
    def first(self) -> list[RgbImage]:
        """Images before the first frame of each unit."""
        return self._canvases

    def clear(self) -> None:
        """Forget the images that wait."""
        self._frames.clear()

    def collect(self, step: Step) -> None:
        """Keep the images of a step until they are drawn, or newer ones are there."""
        self._frames |= step.frames

    def draw(self, step: Step, mission: Mission) -> Iterator[LiveImage]:
        """Draw one of the images that wait, so that no drawing takes long, and those of units that died.

        Args:
            step: the newest step.
            mission: the mission with the interventions so far.
        """
        dead = frozenset(mission.scenario.dead_units(step.time_s))
        for unit in dead:
            self._frames.pop(unit, None)
            if unit not in self._dead:
                self._panels[unit].draw_dead()
                yield self._image(unit)
        self._dead = dead
        if self._frames:
            unit = next(iter(self._frames))
            frame = self._frames.pop(unit)
            shape = mission.shape_at(step.time_s, step.roles)
            lines: list[Array] = outline_px(frame.decision, shape, mission.outline_at(step.time_s))
            self._panels[unit].draw(frame, step.control_sets, outline_px=lines)
            yield self._image(unit)

    def _image(self, unit: int) -> LiveImage:
        return LiveImage(unit, self._canvases[unit], self._panels[unit].picture)


class SmallImages:
    """Live images for a file: small, and only those in which something has moved.

    Attributes:
        newest: picture that is shown, by unit.
    """

    def __init__(self) -> None:
        self.newest: dict[int, RgbImage] = {}

    def changed(self, images: Iterable[LiveImage]) -> list[LiveImage]:
        """Return the images that differ from those shown, with small plain pictures, and keep them."""
        small = []
        for image in images:
            height, width = image.plain.shape[:2]
            size_px = (SMALL_PX, round(SMALL_PX * height / width))
            plain = cv2.resize(image.plain, size_px, interpolation=cv2.INTER_AREA).astype(
                np.uint8, copy=False
            )
            shown = self.newest.get(image.unit)
            if shown is None or np.mean(cv2.absdiff(plain, shown) > CHANGED_LEVELS) > CHANGED_SHARE:
                self.newest[image.unit] = plain
                small.append(replace(image, plain=plain))
        return small
