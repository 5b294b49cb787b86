"""Bodies in the scene: robots and obstacles with their marker cards, units as small multicopters."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skyherd.datasets import Mission
from skyherd.drawing.palette import unit_rgb
from skyherd.markers.dictionary import QUIET_ZONE_CELLS, cells_per_side
from skyherd.play.pictures import marker_picture
from skyherd.play.poses import FACE_UP_AHEAD, field_of_view_rad, wxyz_about_z

if TYPE_CHECKING:
    import viser

BODY = (52, 58, 64)
"""Colour of the robots' bodies."""

WHEEL = (25, 25, 25)
"""Colour of wheels."""

STONE = (120, 110, 100)
"""Colour of obstacles."""

ROTOR = (90, 96, 104)
"""Colour of rotors, drawn half transparent."""

DEAD = (150, 150, 150)
"""Colour of a dead unit."""

UNIT_SIZE = 0.06
"""Arm of a multicopter over its height above the ground. Chosen: visible, far below the units' distances."""

FRUSTUM_SIZE = 0.12
"""Size of a frustum over the unit's height. Chosen: the image is legible, and frustums do not overlap."""


IMAGE_QUALITY = 50
"""JPEG quality of the live images in the scene, per cent. Chosen: ids stay legible, 0.7 of the usual size."""


@dataclass(frozen=True)
class UnitNodes:
    """Nodes of one unit.

    Attributes:
        body: node that moves the multicopter.
        painted: its parts in the unit's colour; the first one can be clicked.
        frustum: frustum of the camera with the live image.
    """

    body: "viser.FrameHandle"
    painted: tuple["viser.BoxHandle", ...]
    frustum: "viser.CameraFrustumHandle"


class Bodies:
    """Maker of the bodies of one mission.

    Args:
        scene: the scene of the server.
        mission: mission at its start.
    """

    def __init__(self, scene: "viser.SceneApi", mission: Mission) -> None:
        self._scene, self._mission = scene, mission
        self._side_m = mission.scenario.marker.side_m

    def add_robot(
        self, robot: int
    ) -> tuple["viser.FrameHandle", list["viser.BoxHandle | viser.ImageHandle"]]:
        """Add a body with two wheels, the marker's card and the number.

        Returns:
            The node that moves the robot, and the nodes that can be clicked.
        """
        side_m, name = self._side_m, f"/robots/{robot}"
        node = self._scene.add_frame(name, show_axes=False)
        size_m = (1.5 * side_m, 1.3 * side_m, 0.35 * side_m)
        body = self._scene.add_box(f"{name}/body", BODY, size_m, position=(0, 0, 0.3 * side_m))
        for left in (-1, 1):
            self._scene.add_cylinder(
                f"{name}/wheel{left}",
                0.28 * side_m,
                0.16 * side_m,
                WHEEL,
                wxyz=(np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0),
                position=(0.0, 0.74 * left * side_m, 0.28 * side_m),
            )
        card = self._add_card(f"{name}/card", robot, 0.49 * side_m)
        self._add_label(f"{name}/number", str(robot), 1.2 * side_m)
        return node, [body, card]

    def add_obstacles(self) -> None:
        """Add a cylinder with its marker's card for each obstacle."""
        mission = self._mission
        places = mission.obstacle_positions_m.tolist()
        radii_m, headings_rad = mission.obstacle_radii_m.tolist(), mission.obstacle_headings_rad.tolist()
        height_m = 0.4 * self._side_m
        for marker, (x, y), radius_m, heading_rad in zip(
            mission.obstacle_ids.tolist(), places, radii_m, headings_rad, strict=True
        ):
            name = f"/obstacles/{marker}"
            self._scene.add_frame(name, show_axes=False, position=(x, y, 0.0), wxyz=wxyz_about_z(heading_rad))
            middle = (0, 0, height_m / 2)
            self._scene.add_cylinder(f"{name}/body", radius_m, height_m, STONE, position=middle)
            self._add_card(f"{name}/card", marker, 1.02 * height_m)

    def add_unit(self, unit: int) -> UnitNodes:
        """Add a multicopter with body, two beams and four rotors, and the frustum of its camera."""
        size_m = UNIT_SIZE * self._mission.scenario.units[unit].height_m
        name, color = f"/units/{unit}", unit_rgb(unit)
        node = self._scene.add_frame(name, show_axes=False)
        parts = [self._scene.add_box(f"{name}/body", color, (0.7 * size_m, 0.5 * size_m, 0.3 * size_m))]
        for sign in (-1, 1):
            beam = (2.0 * size_m, 0.12 * size_m, 0.1 * size_m)
            turned = wxyz_about_z(sign * np.pi / 4)
            parts.append(self._scene.add_box(f"{name}/beam{sign}", color, beam, wxyz=turned))
        for number, corner in enumerate(np.exp(1j * np.pi * (np.arange(4) / 2 + 0.25))):
            self._scene.add_cylinder(
                f"{name}/rotor{number}",
                0.5 * size_m,
                0.04 * size_m,
                ROTOR,
                opacity=0.55,
                position=(float(size_m * corner.real), float(size_m * corner.imag), 0.12 * size_m),
            )
        self._add_label(f"{name}/number", f"unit {unit}", 0.7 * size_m)
        return UnitNodes(node, tuple(parts), self._add_frustum(unit))

    def _add_frustum(self, unit: int) -> "viser.CameraFrustumHandle":
        camera = self._mission.cameras_at(0.0)[unit]
        width, height = camera.size_px
        return self._scene.add_camera_frustum(
            f"/cameras/{unit}",
            field_of_view_rad(camera, 1.0),
            width / height,
            scale=FRUSTUM_SIZE * self._mission.scenario.units[unit].height_m,
            thickness=2.0,
            thickness_units="screen",
            color=unit_rgb(unit),
            format="jpeg",
            jpeg_quality=IMAGE_QUALITY,
        )

    def _add_card(self, name: str, marker: int, height_m: float) -> "viser.ImageHandle":
        """Add the card of a marker, which faces up at a height."""
        dictionary = self._mission.scenario.marker.dictionary
        card_m = self._side_m * (1 + 2 * QUIET_ZONE_CELLS / cells_per_side(dictionary))
        picture = marker_picture(dictionary, marker)
        place = (0.0, 0.0, height_m)
        return self._scene.add_image(
            name, picture, card_m, card_m, format="png", wxyz=FACE_UP_AHEAD, position=place
        )

    def _add_label(self, name: str, text: str, height_m: float) -> None:
        """Add a text above a point, which does not cover the object below it."""
        self._scene.add_label(
            name, text, position=(0.0, 0.0, height_m), anchor="bottom-center", font_screen_scale=0.85
        )
