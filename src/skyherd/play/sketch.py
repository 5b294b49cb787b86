"""A line drawn in the scene by clicks on the ground, along which robots form up."""

from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from skyherd.datasets import polyline_points
from skyherd.drawing.palette import TEMPLATE_COLOR, rgb
from skyherd.geometry import Array
from skyherd.loop import Step
from skyherd.play.changes import Table
from skyherd.play.lines import Lines, chain, circles, lifted
from skyherd.play.session import Change, Session

if TYPE_CHECKING:
    import viser

MAX_CORNERS = 200
"""Maximum number of corners. Chosen: more than anyone clicks."""

MAX_DISTANCE_M = 1e4
"""Maximum distance of a corner from the origin, m. Chosen: far beyond any scene, before the horizon."""

HEIGHT_SIDES = 0.6
"""Height of the drawn line, marker sides. Chosen: above the robots' markers."""


def ground_point(origin: Array, direction: Array) -> Array | None:
    """Return the point (2,), m, where a ray meets the ground; None if it does not, or far away."""
    if not direction[2] < 0 or not origin[2] > 0:
        return None
    place = (origin - direction * (origin[2] / direction[2]))[:2]
    return place if np.abs(place).max() < MAX_DISTANCE_M else None


class Sketch:
    """Line that grows by a corner with each click on the ground while drawing is on.

    Browsers click in threads of the server.

    Args:
        server: server of the page.
        session: session that is asked.
    """

    def __init__(self, server: "viser.ViserServer", session: Session) -> None:
        self._scene, self._session = server.scene, session
        self._side_m = session.mission.scenario.marker.side_m
        self._lines = Lines(server.scene, "/sketch", 4)
        self._lock = Lock()
        self._corners: list[Array] = []
        self._robots_m = session.mission.positions_m
        self.is_on = False

    @property
    def count(self) -> int:
        """Number of corners."""
        return len(self._corners)

    def show(self, step: Step) -> None:
        """Keep the robots' positions."""
        with self._lock:
            self._robots_m = step.positions_m

    def begin(self) -> None:
        """Begin a new line: the next clicks on the ground are its corners."""
        with self._lock:
            self._corners.clear()
            if not self.is_on:
                self.is_on = True
                self._scene.on_click()(self._click)
            self._show()

    def end(self) -> None:
        """End drawing, and remove the line."""
        with self._lock:
            self._corners.clear()
            if self.is_on:
                self.is_on = False
                self._scene.remove_click_callback(self._click)
            self._show()

    def form(self) -> None:
        """Ask for the shape along the line, and end drawing.

        Robots take places near their own: the sum of squared distances is the smallest.

        Raises:
            InputError: robots cannot form up along the line.
        """
        with self._lock:
            corners, robots_m = np.array(self._corners).reshape(-1, 2), self._robots_m
        points, line = polyline_points(corners, len(robots_m))
        robots, places = linear_sum_assignment(cdist(robots_m, points, "sqeuclidean"))
        outline = robots[np.argsort(places)][line]
        table: Table = {"kind": "template", "points": points[places].round(3).tolist()}
        self._session.ask(Change(({**table, "outline": [outline.tolist()]},)))
        self.end()

    def _click(self, event: "viser.SceneClickEvent") -> None:
        place = ground_point(np.array(event.ray_origin), np.array(event.ray_direction))
        with self._lock:
            if place is not None and self.is_on and len(self._corners) < MAX_CORNERS:
                self._corners.append(place)
                self._show()

    def _show(self) -> None:
        corners = lifted(np.array(self._corners).reshape(-1, 2), HEIGHT_SIDES * self._side_m)
        rings = circles(corners, self._side_m / 4)
        self._lines.show(np.concatenate([chain(corners), rings]), np.array(rgb(TEMPLATE_COLOR)))
