"""A recorded run in the 3-D scene: at any time of it, or as one self-contained HTML file."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from skyherd.datasets import Mission
from skyherd.loop import Step
from skyherd.play.lines import lifted
from skyherd.play.messages import MessageFilter
from skyherd.play.pictures import LiveImage, LiveImages, SmallImages
from skyherd.play.poses import Window, view_of
from skyherd.play.scene import TRACE_S, Scene
from skyherd.play.server import start_server, stop_server
from skyherd.report.access import Access, bind

if TYPE_CHECKING:
    import viser
    from viser.infra import StateSerializer

LAST_IMAGES_S = 2.0
"""Time in which each living unit has an image, s. Chosen: twenty images at the usual time step."""

HTML_INTERVAL_S = 0.2
"""Time between two states in an HTML file, s. Chosen: half the size of all steps, and still fluent."""

IMAGES, IMAGE_INTERVAL_S = 100, 2.0
"""Images of all units in an HTML file at most, and the least time between two of a unit, s. Chosen: images
are half of its size."""

WHOLE = Window(0.5, (-0.95, 0.95), (-0.9, 0.9))
"""Window without a panel. Chosen: as narrow as a phone's, so that the team is whole on every screen."""


class Replay:
    """Drawing of a recorded run at any of its steps.

    Images are drawn from the recorded detections: markers as black squares on plain ground.

    Attributes:
        mission: the mission.
        steps: all steps, in the order of time.

    Args:
        server: server of the page.
        mission: as the attribute.
        steps: as the attribute.
        small: draw for a file: small images, and only those in which something has moved.
    """

    def __init__(
        self, server: "viser.ViserServer", mission: Mission, steps: Sequence[Step], *, small: bool = False
    ) -> None:
        self.mission, self.steps = mission, steps
        self._small = SmallImages() if small else None
        self._times_s = [step.time_s for step in steps]
        self.images = LiveImages(mission)
        self.scene = Scene(server, mission)

    @property
    def end_s(self) -> float:
        """Time of the last step, s."""
        return self._times_s[-1]

    def index_at(self, time_s: float) -> int:
        """Return the index of the last step until a time, s; the first one before all."""
        return max(0, bisect_right(self._times_s, time_s + 1e-9) - 1)

    def draw(self, index: int, *, with_images: bool = True) -> list[LiveImage]:
        """Draw a step with the traces before it, and return the units' images.

        Args:
            index: index of the step.
            with_images: also draw the images; they stay as they are otherwise.
        """
        step = self.steps[index]
        self.scene.clear()
        for past in self.steps[self.index_at(step.time_s - TRACE_S) : index + 1]:
            self.scene.collect(past)
        images: list[LiveImage] = []
        if with_images:
            self.images.clear()
            for past in self.steps[self.index_at(step.time_s - LAST_IMAGES_S) : index + 1]:
                self.images.collect(past)
            images += self.images.draw(step, self.mission)
            while self.images.is_waiting:
                images += self.images.draw(step, self.mission)
        if self._small is not None:
            images = self._small.changed(images)
        self.scene.draw(step, self.mission, images)
        return images


def replay_html(mission: Mission, steps: Sequence[Step]) -> str:
    """Return a page with the whole run, which needs no server and no other file.

    Args:
        mission: the mission.
        steps: all steps, in the order of time.
    """
    with _recorded(mission, steps) as scene:
        return scene.as_html()


def replay_data(mission: Mission, steps: Sequence[Step]) -> bytes:
    """Return the whole run as a file that viser's client shows: `replay_html` without the client.

    Args:
        mission: the mission.
        steps: all steps, in the order of time.
    """
    with _recorded(mission, steps) as scene:
        return scene.serialize()


@contextmanager
def _recorded(mission: Mission, steps: Sequence[Step]) -> Iterator["StateSerializer"]:
    """Give the scene of a whole run with its times."""
    with bind("127.0.0.1", 0) as listener:
        server = start_server(Access.make("127.0.0.1", listener.getsockname()[1]), listener, MessageFilter())
        try:
            replay = Replay(server, mission, steps, small=True)
            camera = server.initial_camera
            places_m = np.concatenate([step.positions_m for step in steps])
            points_m = np.concatenate([replay.scene.corners_m, lifted(places_m, 0.0)])
            camera.position, camera.look_at = view_of(points_m, WHOLE)
            replay.draw(0)
            recorded = server.get_scene_serializer()
            seconds = (replay.end_s - steps[0].time_s) * len(mission.scenario.units)
            interval_s = max(IMAGE_INTERVAL_S, seconds / IMAGES)
            shown_s = image_s = steps[0].time_s
            for index, step in enumerate(steps):
                is_last = index == len(steps) - 1
                if step.time_s - shown_s < HTML_INTERVAL_S - 1e-9 and not is_last:
                    continue
                recorded.insert_sleep(step.time_s - shown_s)
                with_images = step.time_s - image_s >= interval_s - 1e-9 or is_last
                replay.draw(index, with_images=with_images)
                shown_s, image_s = step.time_s, step.time_s if with_images else image_s
            yield recorded
        finally:
            stop_server(server)
