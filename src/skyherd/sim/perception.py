"""Simulated perception of a scenario: rendered images with a detector, or projection of the markers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skyherd.datasets import Mission
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.errors import InputError
from skyherd.geometry import ROBOT_FRAME_CORNERS, BoolArray, Image, apply_homography, to_points
from skyherd.markers.dictionary import card_side
from skyherd.messages import Detections, among
from skyherd.render import FrameTruth, Motion, Quad, Renderer, Shot, Shutter, shadows
from skyherd.sim.projected_perception import ProjectedPerception
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import Markers, World
from skyherd.vision import create_detector, explain_mirrored, load_accuracy

PLAIN_TO_SEE = 0.9
"""Minimum share of an image's markers that must be found to prove that it is not mirrored. Chosen: in a
mirrored image the detector finds only markers that are their own mirror images, 4 of the 50 of 4X4_50. A
share of one half could be reached in a small team with many of these."""

COVER_LEVEL = 70.0
"""Grey level of the card that covers a marker. Chosen: that of occluders in scenario files."""


def make_perception(mission: Mission, rng: np.random.Generator) -> Perception:
    """Make the perception of a scenario: `rendered`, `ideal` or `noisy`."""
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
    """Make the perception of a scenario, with the random numbers of its runs."""
    return make_perception(mission, generator(mission.scenario.seed, RunStream.PERCEPTION))


def make_renderer(mission: Mission, rng: np.random.Generator) -> Renderer:
    """Make the renderer of a scenario."""
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
    """Content of the images of one instant.

    Attributes:
        time_s: time of the images.
        of_units: content of each image, ascending by unit; the unit is the stream of the shot.
    """

    time_s: float
    of_units: list[Shot]


class RenderedPerception(Perception):
    """Perception that renders each unit's image with `skyherd.render` and runs the scenario's detector on it.

    Attributes:
        renderer: renderer of the images.
        detector: the scenario's detector.
        can_fork: True if a fork of this process can continue with both. A fork loses the threads of a video
            encoder, and possibly those of a user's own detector.
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
        """Return the content of the given units' images now: all data of the world that `take` needs."""
        shots = []
        for unit in units:
            markers = world.markers_facing(unit)
            shot = Shot(
                world.cameras[unit],
                world.camera_pose(unit),
                markers.ids,
                markers.positions_m,
                markers.headings_rad,
                motion=world.motion(unit) if self._moves or world.imaging[unit].exposure_s else Motion(),
                occluders=[*self._occluders, *self._covers(world, unit, markers)],
                stream=unit,
                imaging=world.imaging[unit],
                frames=markers.frames,
            )
            shots.append(shot)
        return Shots(time_s, shots)

    def _covers(self, world: World, unit: int, markers: Markers) -> list[Quad]:
        """Return cards of one grey level, each over the whole card of a covered marker."""
        if not world.covered_ids:
            return []
        covered = markers.take(np.flatnonzero(among(markers.ids, world.covered_ids)))
        card = card_side(self.dictionary) * ROBOT_FRAME_CORNERS
        if covered.frames is None:
            turned = self.side_m * card * np.exp(1j * covered.headings_rad)[:, None]
            corners_m = to_points(turned) + covered.positions_m[:, None]
        else:
            pose = world.camera_pose(unit)
            grounds = shadows(pose, covered.positions_m, covered.headings_rad, self.side_m, covered.frames)
            corners_m = np.array([apply_homography(ground, to_points(card)) for ground in grounds])
        return [Quad(corners, COVER_LEVEL) for corners in corners_m]

    def take(self, shot: Shot, time_s: float) -> Sight:
        """Render an image and detect the markers in it."""
        return self.read(shot, time_s, self.renderer.render(shot))

    def read(self, shot: Shot, time_s: float, image: Image) -> Sight:
        """Detect the markers in an image, and evaluate them by the ground truth of its shot."""
        truth, unit = self.renderer.truth(shot), shot.stream
        detections = self.detector.detect(image, time_s=time_s, unit_id=unit)
        whole_ids = truth.ids[truth.whole]
        right = _right(detections, truth)
        found_ids = whole_ids[(whole_ids[:, None] == detections.ids[right]).any(axis=1)]
        if unit in self._unproven:
            self._prove_unmirrored(unit, image, len(detections), found_ids.size / max(whole_ids.size, 1))
        return Sight(detections, whole_ids, found_ids, int((~right).sum()), image)

    def skip(self, shot: Shot) -> None:
        """Skip an image that another process renders; the noise of later images stays the same."""
        self.renderer.skip(shot)

    def _prove_unmirrored(self, unit: int, image: Image, found: int, found_whole: float) -> None:
        """Raise an error for a mirrored stream; called for each unit's images until one has a detection.

        A mirrored marker is not in the dictionary, except for a few symmetric ones. The mirror image is
        searched only if few markers were found, because this takes as long as a search of the whole image.

        Args:
            unit: unit of the image.
            image: the image.
            found: number of detections in it.
            found_whole: share of the whole markers in the image that were found.
        """
        if found_whole < PLAIN_TO_SEE and (why := explain_mirrored(image, self.dictionary)):
            raise InputError(f"unit {unit}", why, "an image as the eye sees it")
        if found:
            self._unproven.discard(unit)


def _right(detections: Detections, truth: FrameTruth) -> BoolArray:
    """Return the mask (N,) of detections whose marker is in view, at most half a side away."""
    order = np.argsort(truth.ids)
    place = np.searchsorted(truth.ids, detections.ids, sorter=order)
    row = order[np.minimum(place, truth.ids.size - 1)]
    error = np.linalg.norm(truth.centers_px[row] - detections.centers_px, axis=1)
    return np.asarray((truth.ids[row] == detections.ids) & (error <= detections.sides_px / 2))
