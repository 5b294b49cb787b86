"""From the world to a unit's detections: through rendered pixels, or by projection, exact or noisy."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from skyherd.datasets import Mission
from skyherd.errors import InputError
from skyherd.geometry import BoolArray, IntArray
from skyherd.markers.dictionary import card_side, headings_of_corners, sides_of_corners
from skyherd.messages import Detections
from skyherd.random_streams import RunStream, generator
from skyherd.render import (
    Camera,
    CameraPose,
    FrameTruth,
    Motion,
    Renderer,
    Shutter,
    TeamImage,
    project_team,
)
from skyherd.sim.world import Markers, World
from skyherd.vision import DetectorAccuracy, create_detector, explain_mirrored, load_accuracy

Image = npt.NDArray[np.uint8]

PLAIN_TO_SEE = 0.9
"""Share of the markers of an image that, if they are found, prove that it is not mirrored. *Chosen*: of a
mirrored image only markers are found that are their own mirror images, 4 of the 50 of 4X4_50; at half of
it, a small team in which these are many would pass."""


@dataclass(frozen=True)
class Sight:
    """What one unit's camera gave, and the truth that recall is judged by.

    Attributes:
        detections: for the controller.
        whole_ids: robots and obstacles whose whole marker card is in the image.
        found_ids: those of them that were detected.
        false_detections: detections of neither robot nor obstacle, or farther than half a side from theirs.
        image: the picture, if one was made.
    """

    detections: Detections
    whole_ids: IntArray
    found_ids: IntArray
    false_detections: int
    image: Image | None


class Perception(Protocol):
    """From the world to what the units detect: by rendering and detecting, by projection, or otherwise.

    It is the one place in the loop where the truth turns into detections, so it alone may read `world`; what
    it puts into `Sight.detections` is all that the controllers get.
    """

    def look(self, world: World, units: Sequence[int], time_s: float) -> Iterable[Sight]:
        """What each of the given units sees now.

        Args:
            world: the truth: `world.cameras[unit]`, `world.camera_pose(unit)` and `world.markers`.
            units: those that take an image now, ascending; dead units and lost frames are not among them.
            time_s: now; called once a step, in the order of time, also with no units at all.

        Returns:
            One `Sight` for each unit, in the order of `units`: a list, or an iterator, in which case units
            decide while images of others are still being made. Its detections carry that unit's id and this
            time. The same calls after the same construction must give the same result: random numbers come
            from a generator that is passed to the constructor.
        """
        ...


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
class CameraView:
    """One camera at the moment that it takes an image.

    Attributes:
        unit: whose camera it is.
        camera: its intrinsics and lens.
        pose: where it is.
        motion: velocities of camera and markers; still where the shutter takes no time.
    """

    unit: int
    camera: Camera
    pose: CameraPose
    motion: Motion


@dataclass(frozen=True)
class Scene:
    """What the images of one instant are made of, apart from what is the same in all of a run.

    Attributes:
        time_s: when they are taken.
        markers: of robots and obstacles.
        views: the cameras that take an image, ascending by unit.
    """

    time_s: float
    markers: Markers
    views: list[CameraView]


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
        scene = self.scene(world, units, time_s)
        return [self.take(scene, view) for view in scene.views]

    def scene(self, world: World, units: Sequence[int], time_s: float) -> Scene:
        """What `take` needs to know of the world, for the images of the given units now."""
        views = [
            CameraView(
                unit,
                world.cameras[unit],
                world.camera_pose(unit),
                world.motion(unit) if self._moves else Motion(),
            )
            for unit in units
        ]
        return Scene(time_s, world.markers, views)

    def take(self, scene: Scene, view: CameraView) -> Sight:
        """Render the image of one of a scene's cameras and detect the markers in it."""
        return self.read(scene, view, self.draw(scene, view))

    def draw(self, scene: Scene, view: CameraView) -> Image:
        """Render the image of one of a scene's cameras."""
        markers = scene.markers
        return self.renderer.render(
            view.camera,
            view.pose,
            markers.ids,
            markers.positions_m,
            markers.headings_rad,
            motion=view.motion,
            occluders=self._occluders,
            stream=view.unit,
        )

    def read(self, scene: Scene, view: CameraView, image: Image) -> Sight:
        """Detect the markers in the image of one of a scene's cameras, and judge them by the truth."""
        markers = scene.markers
        truth = self.renderer.truth(
            view.camera,
            view.pose,
            markers.ids,
            markers.positions_m,
            markers.headings_rad,
            motion=view.motion,
            occluders=self._occluders,
        )
        detections = self.detector.detect(image, time_s=scene.time_s, unit_id=view.unit)
        whole_ids = truth.ids[truth.whole]
        right = _right(detections, truth)
        found_ids = whole_ids[(whole_ids[:, None] == detections.ids[right]).any(axis=1)]
        if view.unit in self._unproven:
            self._prove_unmirrored(view.unit, image, len(detections), found_ids.size / max(whole_ids.size, 1))
        return Sight(detections, whole_ids, found_ids, int((~right).sum()), image)

    def skip(self, view: CameraView) -> None:
        """Leave out an image that another process draws; the noise of those that follow is as after it."""
        self.renderer.sensor.skip(view.camera.size_px)

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


class ProjectedPerception(Perception):
    """Exact projection of every marker whose card is whole in view, or what a detector would make of it.

    Args:
        side_m: side of the markers.
        dictionary: of the markers.
        accuracy: the detector by whose measured recall markers are missed, each for itself in each image, and
            by whose measured errors places, headings, sides and shapes are wrong; none for exact points of
            all markers.
        rng: what draws both.
    """

    def __init__(
        self,
        side_m: float,
        dictionary: str,
        *,
        accuracy: DetectorAccuracy | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.side_m, self.dictionary, self.accuracy = side_m, dictionary, accuracy
        self.rng = rng or np.random.default_rng(0)

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """Project the markers into each unit's image."""
        views = [(world.cameras[unit], world.camera_pose(unit)) for unit in units]
        markers, card_side_m = world.markers, self.side_m * card_side(self.dictionary)
        images = project_team(views, markers.positions_m, markers.headings_rad, self.side_m, card_side_m)
        return [
            self._sight(world, unit, time_s, image, markers.ids[image.rows])
            for unit, image in zip(units, images, strict=True)
        ]

    def _sight(self, world: World, unit: int, time_s: float, image: TeamImage, ids: IntArray) -> Sight:
        """What a unit makes of the markers `ids` that are whole in its image."""
        centers, corners, whole_ids = image.centers_px, image.corners_px, ids
        headings, sides = headings_of_corners(centers, corners), sides_of_corners(corners)
        covariances = np.zeros((ids.size, 3, 3))
        if self.accuracy is not None:
            found = self.accuracy.found(sides, self.rng)
            ids, centers, corners = ids[found], centers[found], corners[found]
            covariances = self.accuracy.covariances(sides[found])
            error = np.sqrt(np.einsum("nii->ni", covariances)) * self.rng.standard_normal((ids.size, 3))
            shapes = self.accuracy.draw_shapes(sides[found], error[:, 2], self.rng)
            corners = centers[:, None] + (corners - centers[:, None]) @ shapes.swapaxes(1, 2)
            centers, corners = centers + error[:, :2], corners + error[:, None, :2]
            headings, sides = headings[found] + error[:, 2], sides_of_corners(corners)
        detections = Detections(
            unit_id=unit,
            time_s=time_s,
            image_size_px=np.array(world.cameras[unit].size_px),
            ids=ids,
            centers_px=centers,
            headings_rad=headings,
            sides_px=sides,
            corners_px=corners,
            covariances=covariances,
        )
        return Sight(detections, whole_ids, ids, 0, None)
