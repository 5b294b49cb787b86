"""A recorded run in the 3-D scene: at any time of it, or as one self-contained HTML file."""

from bisect import bisect_right
from collections.abc import Sequence
from typing import TYPE_CHECKING

from skyherd.datasets import Mission
from skyherd.loop import Step
from skyherd.play.messages import MessageFilter
from skyherd.play.pictures import LiveImage, LiveImages
from skyherd.play.poses import Window, view_of
from skyherd.play.scene import TRACE_S, Scene
from skyherd.play.server import start_server, stop_server
from skyherd.report.access import Access, bind

if TYPE_CHECKING:
    import viser

LAST_IMAGES_S = 2.0
"""Time in which each living unit has an image, s. Chosen: twenty images at the usual time step."""

HTML_INTERVAL_S = 0.2
"""Time between two states in an HTML file, s. Chosen: half the size of all steps, and still fluent."""

IMAGE_INTERVAL_S = 1.0
"""Time between two images of a unit in an HTML file, s. Chosen: images are most of its size."""

WHOLE = Window(0.6, (-0.95, 0.95), (-0.9, 0.9))
"""Window without a panel. Chosen: narrow, so that the team is whole on screens, and nearly so on phones."""


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
    """

    def __init__(self, server: "viser.ViserServer", mission: Mission, steps: Sequence[Step]) -> None:
        self.mission, self.steps = mission, steps
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
        self.scene.draw(step, self.mission, images)
        return images


def replay_html(mission: Mission, steps: Sequence[Step]) -> str:
    """Return a page with the whole run, which needs no server and no other file.

    Args:
        mission: the mission.
        steps: all steps, in the order of time.
    """
    with bind("127.0.0.1", 0) as listener:
        server = start_server(Access.make("127.0.0.1", listener.getsockname()[1]), listener, MessageFilter())
        try:
            replay = Replay(server, mission, steps)
            camera = server.initial_camera
            camera.position, camera.look_at = view_of(replay.scene.corners_m, WHOLE)
            replay.draw(0)
            recorded = server.get_scene_serializer()
            shown_s = image_s = steps[0].time_s
            for index, step in enumerate(steps):
                is_last = index == len(steps) - 1
                if step.time_s - shown_s < HTML_INTERVAL_S - 1e-9 and not is_last:
                    continue
                recorded.insert_sleep(step.time_s - shown_s)
                with_images = step.time_s - image_s >= IMAGE_INTERVAL_S - 1e-9 or is_last
                replay.draw(index, with_images=with_images)
                shown_s, image_s = step.time_s, step.time_s if with_images else image_s
            return recorded.as_html()
        finally:
            stop_server(server)
