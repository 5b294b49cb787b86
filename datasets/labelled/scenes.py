"""The scene of one image of a set: it renders the image, and gives truth and bound of its markers.

The markers' sides are 1 m on the ground, so that metres are marker sides.
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
"""Least and greatest side of the clutter, marker sides. *Chosen*: such as could be taken for markers."""


@dataclass(frozen=True)
class Station:
    """One of the cameras of a set, and the ground under it.

    Attributes:
        number: the camera's number.
        camera: its intrinsics and lens.
        psf_px: standard deviation of its lens's blur.
        ground: the ground under it.
        ground_seed: seed of the ground's texture.
    """

    number: int
    camera: CameraModel
    psf_px: float
    ground: GroundModel
    ground_seed: int


@dataclass(frozen=True)
class Scene:
    """What one image is of, and how it was taken.

    Attributes:
        station: camera and ground.
        pose: where the camera is.
        dictionary: dictionary of the markers.
        black: grey level of the markers' black.
        white: grey level of their cards.
        ids: (N,) markers, ascending.
        positions_m: (N, 2) their places on the ground, in marker sides.
        headings_rad: (N,) their headings, counter-clockwise from +x.
        sensor: what the sensor does to the image.
        motion_px: length of the streak that a point leaves.
        motion: velocity of the camera, which leaves it.
        clutter: about how many dark quadrilaterals are in the image.
        occluders: what lies over markers.
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
        """The camera: intrinsics and lens."""
        return self.station.camera.make()

    @cached_property
    def truth(self) -> FrameTruth:
        """Exact truth about the markers, those outside the image as well."""
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
        """Cramér–Rao bound (N, 3, 3) on (u px, v px, heading rad) of each marker, as if wholly seen.

        At the light that falls on its centre, shot noise taken at mid-grey, rounding included; a streak L px
        long adds L² / 24 to the blur's variance, and defocus and coma theirs, in the markers' mean. Colour
        filters take from what the raw pixels tell; what is done to these afterwards is left out.
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
    """The ground of a camera. The last two are kept: one takes long to make and much memory."""
    image = station.ground.image
    return station.ground.make(
        station.ground_seed,
        psf_px=station.psf_px,
        image=None if image is None else read_grey(folder / image),
    )


def corners_m(positions_m: Array, headings_rad: Array, side_m: float) -> Array:
    """Corners (N, 4, 2) of squares on the ground, in the corner order of a marker.

    Args:
        positions_m: (N, 2) their centres.
        headings_rad: (N,) their headings, counter-clockwise from +x.
        side_m: their side.
    """
    offsets = side_m * ROBOT_FRAME_CORNERS * np.exp(1j * headings_rad)[:, None]
    return positions_m[:, None] + to_points(offsets)
