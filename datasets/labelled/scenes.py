"""Scene of one image of a set: rendered image, ground truth, and Cramér–Rao bounds of its markers.

A marker side is 1 m on the ground, so that metres are marker sides.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from skyherd.datasets.configuration.camera_models import CameraModel
from skyherd.datasets.configuration.scene_models import GroundModel, OccluderModel, SensorModel
from skyherd.datasets.labelled.formats.outlines import area
from skyherd.files.images import read_grey
from skyherd.geometry import ROBOT_FRAME_CORNERS, UNIFORM_VARIANCE, Array, IntArray, to_points
from skyherd.markers.cramer_rao import pose_covariances
from skyherd.markers.dictionary import card_side
from skyherd.render import (
    Camera,
    CameraPose,
    Clutter,
    FrameTruth,
    Ground,
    Motion,
    Renderer,
    Shot,
    footprint_m,
    project_markers,
)

CLUTTER_SIDES = (0.4, 1.2)
"""Minimum and maximum side of the clutter, marker sides. Chosen: similar to that of markers."""


@dataclass(frozen=True)
class Station:
    """One of the cameras of a set, and its ground.

    Attributes:
        number: the camera's number.
        camera: its intrinsics and lens.
        psf_px: standard deviation of its lens's blur.
        ground: the ground below it.
        ground_seed: seed of the ground's texture.
    """

    number: int
    camera: CameraModel
    psf_px: float
    ground: GroundModel
    ground_seed: int


@dataclass(frozen=True)
class Scene:
    """Content and imaging conditions of one image.

    Attributes:
        station: camera and ground.
        pose: pose of the camera.
        dictionary: dictionary of the markers.
        black: grey level of the markers' black.
        white: grey level of their cards.
        ids: (N,) markers, ascending.
        positions_m: (N, 2) their positions on the ground, in marker sides.
        headings_rad: (N,) their headings, counter-clockwise from +x.
        sensor: model of the sensor.
        motion_px: length of the motion streak of a point.
        motion: velocity of the camera that causes the streak.
        clutter: expected number of dark quadrilaterals in the image.
        occluders: shapes over the markers.
        noise_key: seed of noise and clutter: the set's seed, the stream, the image's number.
    """

    station: Station
    pose: CameraPose
    dictionary: str
    black: float
    white: float
    ids: IntArray
    positions_m: Array
    headings_rad: Array
    sensor: SensorModel
    motion_px: float
    motion: Motion
    clutter: int
    occluders: Sequence[OccluderModel]
    noise_key: tuple[int, int, int]

    @cached_property
    def camera(self) -> Camera:
        """Camera: intrinsics and lens."""
        return self.station.camera.make()

    @cached_property
    def truth(self) -> FrameTruth:
        """Ground truth of all markers, including those outside the image."""
        return project_markers(
            self.camera,
            self.pose,
            self.positions_m,
            self.headings_rad,
            side_m=1.0,
            card_side_m=card_side(self.dictionary),
            ids=self.ids,
            occluders=[occluder.make() for occluder in self.occluders],
        )

    def render(self, folder: Path) -> npt.NDArray[np.uint8]:
        """Render the image: grey levels (height, width). Pictures of the ground are relative to `folder`.

        Raises:
            InputError: a picture of the ground cannot be read.
        """
        sensor, rng = self.sensor, np.random.default_rng(self.noise_key)
        ground = copy(_floor(self.station, folder))
        if self.clutter:
            density = self.clutter / area(footprint_m(self.camera, self.pose))
            ground.clutter = Clutter(
                seed=int(rng.integers(2**31)), density_per_m2=density, side_m=CLUTTER_SIDES
            )
        renderer = Renderer(
            self.dictionary,
            1.0,
            ground,
            sensor.make(rng),
            psf_px=sensor.psf_px,
            black=self.black,
            white=self.white,
            shutter=sensor.make_shutter(),
            lens_blur=sensor.lens_blur.make(),
        )
        return renderer.render(
            Shot(
                self.camera,
                self.pose,
                self.ids,
                self.positions_m,
                self.headings_rad,
                motion=self.motion,
                occluders=[occluder.make() for occluder in self.occluders],
            )
        )

    def bounds(self) -> Array:
        """Return the Cramér–Rao bound (N, 3, 3) on (u px, v px, heading rad) of wholly visible markers.

        The bound uses the light at the marker's centre, the shot noise at mid-grey, and the rounding noise. A
        streak of L px adds L² / 24 to the variance of the blur. Defocus and coma add the mean of their
        variances over the markers. Colour filters reduce the information of the raw pixels. Later processing
        is not modelled.
        """
        sensor, truth = self.sensor, self.truth
        lens = sensor.lens_blur.make().variances_px2(self.camera, self.pose, truth.centers_px)
        spread = self.motion_px**2 / 24 + (float(lens.mean()) if len(lens) else 0.0)
        bounds = pose_covariances(
            self.dictionary,
            truth.ids,
            truth.images_marker,
            psf_px=float(np.hypot(sensor.psf_px, spread**0.5)),
            noise=1.0,
            black=self.black,
            white=self.white,
            ground=self.station.ground.mean,
        )
        last = np.array(self.camera.size_px) - 1
        at = np.rint(truth.centers_px).astype(int).clip(0, last)
        light = sensor.gain * sensor.make_illumination().of(self.camera.size_px)[at[:, 1], at[:, 0]].astype(
            float
        )
        signal = light * (self.black + self.white) / 2
        noise = (sensor.noise**2 + sensor.shot * signal) / sensor.processing.make().mosaic.information
        variance = noise + UNIFORM_VARIANCE
        return np.asarray(bounds * (variance / light**2)[:, None, None])


@lru_cache(maxsize=2)
def _floor(station: Station, folder: Path) -> Ground:
    """Make the ground of a camera. Two are cached, because one takes much time and memory."""
    image = station.ground.image
    return station.ground.make(
        station.ground_seed,
        psf_px=station.psf_px,
        image=None if image is None else read_grey(folder / image),
    )


def corners_m(positions_m: Array, headings_rad: Array, side_m: float) -> Array:
    """Return the corners (N, 4, 2) of squares on the ground, in the corner order of a marker.

    Args:
        positions_m: (N, 2) centres.
        headings_rad: (N,) headings, counter-clockwise from +x.
        side_m: side of the squares.
    """
    offsets = side_m * ROBOT_FRAME_CORNERS * np.exp(1j * headings_rad)[:, None]
    return positions_m[:, None] + to_points(offsets)
