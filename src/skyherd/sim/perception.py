"""From the world to a unit's detections, as a scenario asks for it; among others through rendered pixels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.datasets import Mission
from skyherd.errors import InputError
from skyherd.geometry import BoolArray, Image
from skyherd.messages import Detections
from skyherd.random_streams import RunStream, generator
from skyherd.render import FrameTruth, Motion, Renderer, Shot, Shutter
from skyherd.sim.projected_perception import ProjectedPerception
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World
from skyherd.vision import create_detector, explain_mirrored, load_accuracy

PLAIN_TO_SEE = 0.9
"""Share of the markers of an image that, if they are found, prove that it is not mirrored. *Chosen*: of a
mirrored image only markers are found that are their own mirror images, 4 of the 50 of 4X4_50; at half of
it, a small team in which these are many would pass."""


def make_perception(mission: Mission, rng: np.random.Generator) -> Perception:
    """The perception a scenario asks for: `rendered`, `ideal` or `noisy`."""
    scenario = mission.scenario
    if scenario.perception == "ideal":
        return ProjectedPerception(scenario.marker.side_m, scenario.marker.dictionary)
    if scenario.perception == "noisy":
        accuracy = load_accuracy(
            scenario.detector,
            dictionary=scenario.marker.dictionary,
            noise=scenario.sensor.noise,
            psf_px=scenario.sensor.psf_px,
        )
        return ProjectedPerception(
            scenario.marker.side_m, scenario.marker.dictionary, accuracy=accuracy, rng=rng
        )
    return RenderedPerception(mission, rng)


def make_run_perception(mission: Mission) -> Perception:
    """The perception a scenario asks for, with the random numbers of its runs."""
    return make_perception(mission, generator(mission.scenario.seed, RunStream.PERCEPTION))


def make_renderer(mission: Mission, rng: np.random.Generator) -> Renderer:
    """The renderer a scenario asks for."""
    scenario = mission.scenario
    sensor = scenario.sensor
    return Renderer(
        scenario.marker.dictionary,
        scenario.marker.side_m,
        scenario.ground.make(scenario.seed, psf_px=sensor.psf_px, image=mission.ground_image),
        sensor.make(rng),
        psf_px=sensor.psf_px,
        shutter=sensor.make_shutter(),
        lens_blur=sensor.lens_blur.make(),
    )


@dataclass(frozen=True)
class Shots:
    """What the images of one instant show.

    Attributes:
        time_s: when they are taken.
        of_units: what each image shows, ascending by unit, which is its stream.
    """

    time_s: float
    of_units: list[Shot]


class RenderedPerception(Perception):
    """Draws each unit's camera image with `skyherd.render`, and runs the scenario's detector on it.

    Attributes:
        renderer: draws.
        detector: detects.
        can_fork: whether a fork of this process can go on with both: not with a video's encoder, whose
            threads are lost, nor with a detector of the user's own, which may have threads too.
    """

    def __init__(self, mission: Mission, rng: np.random.Generator) -> None:
        scenario = mission.scenario
        self.side_m, self.dictionary = scenario.marker.side_m, scenario.marker.dictionary
        self._unproven = set(range(len(scenario.units)))
        self.detector = create_detector(scenario.detector, dictionary=self.dictionary)
        self.renderer = make_renderer(mission, rng)
        self._occluders = [occluder.make() for occluder in scenario.occluders]
        self._moves = self.renderer.shutter != Shutter()
        self.can_fork = ":" not in scenario.detector and not self.renderer.sensor.is_video

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """Render each unit's image and detect the markers in it."""
        return [self.take(shot, time_s) for shot in self.shots(world, units, time_s).of_units]

    def shots(self, world: World, units: Sequence[int], time_s: float) -> Shots:
        """Return what the images of the given units show now: all that `take` needs to know of the world."""
        markers = world.markers
        shots = [
            Shot(
                world.cameras[unit],
                world.camera_pose(unit),
                markers.ids,
                markers.positions_m,
                markers.headings_rad,
                motion=world.motion(unit) if self._moves else Motion(),
                occluders=self._occluders,
                stream=unit,
            )
            for unit in units
        ]
        return Shots(time_s, shots)

    def take(self, shot: Shot, time_s: float) -> Sight:
        """Render an image and detect the markers in it."""
        return self.read(shot, time_s, self.renderer.render(shot))

    def read(self, shot: Shot, time_s: float, image: Image) -> Sight:
        """Detect the markers in an image, and judge them by the truth about its shot."""
        truth, unit = self.renderer.truth(shot), shot.stream
        detections = self.detector.detect(image, time_s=time_s, unit_id=unit)
        whole_ids = truth.ids[truth.whole]
        right = _right(detections, truth)
        found_ids = whole_ids[(whole_ids[:, None] == detections.ids[right]).any(axis=1)]
        if unit in self._unproven:
            self._prove_unmirrored(unit, image, len(detections), found_ids.size / max(whole_ids.size, 1))
        return Sight(detections, whole_ids, found_ids, int((~right).sum()), image)

    def skip(self, shot: Shot) -> None:
        """Leave out an image that another process draws; the noise of those that follow is as after it."""
        self.renderer.sensor.skip(shot.camera.size_px)

    def _prove_unmirrored(self, unit: int, image: Image, found: int, found_whole: float) -> None:
        """Refuse a mirrored stream; asked of each unit's images until one shows something.

        A mirrored marker is no marker of its dictionary, but for a few. An image of which most markers were
        found needs no look at its mirror image, which takes as long as a search of the whole image.

        Args:
            unit: whose image it is.
            image: what it shows.
            found: number of detections in it.
            found_whole: share of the markers whole in the image that were found.
        """
        if found_whole < PLAIN_TO_SEE and (why := explain_mirrored(image, self.dictionary)):
            raise InputError(f"unit {unit}", why, "an image as the eye sees it")
        if found:
            self._unproven.discard(unit)


def _right(detections: Detections, truth: FrameTruth) -> BoolArray:
    """Which detections (N,) are of a marker that is there, and within half a side of it."""
    order = np.argsort(truth.ids)
    place = np.searchsorted(truth.ids, detections.ids, sorter=order).clip(max=truth.ids.size - 1)
    row = order[place]
    error = np.linalg.norm(truth.centers_px[row] - detections.centers_px, axis=1)
    return np.asarray((truth.ids[row] == detections.ids) & (error <= detections.sides_px / 2))
