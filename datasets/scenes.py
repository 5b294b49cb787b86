"""The scene of each image of a set: drawn from seed and number alone, rendered, and told the truth about.

Streams of random numbers are `[seed, use, number]`, so that an image is the same whoever makes it, and when.
The markers' sides are 1 m on the ground: metres are marker sides.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from skyherd.bound import pose_covariances
from skyherd.datasets.outlines import area
from skyherd.datasets.ranges import draw, draw_whole
from skyherd.datasets.scene_models import (
    CameraModel,
    DistortionModel,
    GroundModel,
    OccluderModel,
    SensorModel,
)
from skyherd.datasets.spec import DatasetSpec, OccludersSpec, SensorSpec, SpecFile
from skyherd.geometry import Array, BoolArray, IntArray, apply_homography, inverse, to_points
from skyherd.image_files import read_grey
from skyherd.markers import CORNERS, card_side, dictionary_size
from skyherd.optics import total_sigma_px
from skyherd.render import (
    Camera,
    CameraPose,
    Clutter,
    FrameTruth,
    Ground,
    Motion,
    Renderer,
    Sensor,
    footprint_m,
    homography_image_ground,
    project,
    project_markers,
)
from skyherd.render.camera import undistort

CAMERA, FLOOR, IMAGE, NOISE = range(4)
"""Uses of random numbers."""

EXPOSURE_S = 0.01
CANDIDATES = 60
"""Places that are tried for each marker."""

CLUTTER_SIDES = (0.4, 1.2)
ROUNDING_VARIANCE = 1.0 / 12.0
"""Variance of rounding to whole grey levels, which the bound counts as noise."""


@dataclass(frozen=True)
class Station:
    """One of the cameras, and the ground under it.

    Attributes:
        number: of the camera.
        camera: its intrinsics.
        psf_px: standard deviation of its lens's blur.
        ground: what lies under it.
    """

    number: int
    camera: CameraModel
    psf_px: float
    ground: GroundModel


@dataclass(frozen=True)
class Scene:
    """What one image is of, and how it was taken.

    Attributes:
        station: camera and ground.
        pose: where the camera is.
        dictionary: of the markers.
        black: grey level of their black.
        white: grey level of their card.
        ids: (N,) markers, ascending.
        positions_m: (N, 2) where they lie.
        headings_rad: (N,) their headings on the ground.
        sensor: what the image suffers.
        motion_px: length of the streak of a point.
        motion: of the camera.
        clutter: how many dark quadrilaterals are in the image, about.
        occluders: what lies over markers.
        noise_key: seed of noise and clutter.
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
        """The camera's intrinsics."""
        return self.station.camera.make()

    @cached_property
    def truth(self) -> FrameTruth:
        """Exact truth about the markers."""
        return project_markers(
            self.camera,
            self.pose,
            self.positions_m,
            self.headings_rad,
            1.0,
            card_side(self.dictionary),
            ids=self.ids,
            occluders=[occluder.make() for occluder in self.occluders],
        )

    def render(self, file: SpecFile) -> npt.NDArray[np.uint8]:
        """The image (height, width)."""
        sensor, rng = self.sensor, np.random.default_rng(self.noise_key)
        ground = copy(_floor(file.spec.seed, self.station, file.folder))
        if self.clutter:
            density = self.clutter / area(footprint_m(self.camera, self.pose))
            ground.clutter = Clutter(int(rng.integers(2**31)), density, CLUTTER_SIDES)
        renderer = Renderer(
            self.dictionary,
            1.0,
            ground,
            Sensor(
                sensor.noise,
                rng,
                shot=sensor.shot,
                gain=sensor.gain,
                illumination=sensor.illumination(),
                jpeg_quality=sensor.jpeg_quality,
            ),
            psf_px=sensor.psf_px,
            black=self.black,
            white=self.white,
            shutter=sensor.shutter(),
        )
        return renderer.render(
            self.camera,
            self.pose,
            self.ids,
            self.positions_m,
            self.headings_rad,
            motion=self.motion,
            occluders=[occluder.make() for occluder in self.occluders],
        )

    def bounds(self) -> Array:
        """Cramér–Rao bound (N, 3, 3) on (u px, v px, heading rad) of each marker, as if wholly seen.

        At the light that falls on its centre, shot noise taken at mid-grey, rounding included; a streak L px
        long adds L² / 24 to the blur's variance. What a JPEG does is left out.
        """
        sensor, truth = self.sensor, self.truth
        bounds = pose_covariances(
            self.dictionary,
            truth.ids,
            truth.images_marker,
            psf_px=float(np.hypot(sensor.psf_px, self.motion_px / 24**0.5)),
            noise=1.0,
            black=self.black,
            white=self.white,
            ground=self.station.ground.mean,
        )
        last = np.array(self.camera.size_px) - 1
        at = np.rint(truth.centers_px).astype(int).clip(0, last)
        light = sensor.gain * sensor.illumination().of(self.camera.size_px)[at[:, 1], at[:, 0]].astype(float)
        signal = light * (self.black + self.white) / 2
        variance = sensor.noise**2 + sensor.shot * signal + ROUNDING_VARIANCE
        return np.asarray(bounds * (variance / light**2)[:, None, None])


def station_number(spec: DatasetSpec, index: int) -> int:
    """Which camera takes an image."""
    return int(np.random.default_rng([spec.seed, IMAGE, index]).integers(spec.cameras))


@lru_cache(maxsize=64)
def make_station(spec_json: str, number: int) -> Station:
    """Draw one of the cameras of a set, given as JSON, and its ground."""
    spec = DatasetSpec.model_validate_json(spec_json)
    rng = np.random.default_rng([spec.seed, CAMERA, number])
    lens = {name: draw(rng, span) for name, span in spec.camera.distortion}
    camera = CameraModel(
        size_px=spec.size_px,
        half_angle_deg=draw(rng, spec.camera.half_angle_deg),
        aspect=draw(rng, spec.camera.aspect),
        distortion=DistortionModel(**lens),
    )
    psf_px, model = draw(rng, spec.camera.psf_px), spec.ground
    choice = int(rng.integers(len(model.kinds) + len(model.images)))
    level = {"mean": draw(rng, model.mean), "contrast": draw(rng, model.contrast)}
    tile_m, width_m = draw(rng, model.tile_sides), draw(rng, model.image_sides)
    if choice >= len(model.kinds):
        picture = model.images[choice - len(model.kinds)]
        return Station(
            number, camera, psf_px, GroundModel(kind="image", image=picture, tile_m=width_m, **level)
        )
    kind = model.kinds[choice]
    tiles = tile_m if kind == "tiles" else None
    return Station(number, camera, psf_px, GroundModel(kind=kind, tile_m=tiles, **level))


@lru_cache(maxsize=2)
def _floor(seed: int, station: Station, folder: Path) -> Ground:
    """The ground of a camera: dear to make, and large."""
    model = station.ground
    return Ground(
        int(np.random.default_rng([seed, FLOOR, station.number]).integers(2**31)),
        kind=model.kind,
        mean=model.mean,
        contrast=model.contrast,
        tile_m=model.period_m,
        sigma_px=total_sigma_px(station.psf_px),
        image=None if model.image is None else read_grey(folder / model.image),
    )


def make_scene(spec: DatasetSpec, index: int) -> Scene:
    """Draw the scene of one image."""
    rng = np.random.default_rng([spec.seed, IMAGE, index])
    station = make_station(spec.model_dump_json(), int(rng.integers(spec.cameras)))
    pose = _draw_pose(spec, station, rng)
    motion_px, sensor = draw(rng, spec.sensor.motion_px), _draw_sensor(spec.sensor, station.psf_px, rng)
    toward, speed = rng.uniform(-np.pi, np.pi), motion_px / EXPOSURE_S * pose.height_m
    speed /= station.camera.focal_length_px
    black, white = draw(rng, spec.markers.black), draw(rng, spec.markers.white)
    clutter = draw_whole(rng, spec.ground.clutter)
    ids, positions_m, headings_rad = _draw_team(spec, station.camera.make(), pose, rng)
    return Scene(
        station=station,
        pose=pose,
        dictionary=spec.markers.dictionary,
        black=black,
        white=white,
        ids=ids,
        positions_m=positions_m,
        headings_rad=headings_rad,
        sensor=sensor,
        motion_px=motion_px,
        motion=Motion(camera_mps=(float(speed * np.cos(toward)), float(speed * np.sin(toward)), 0.0)),
        clutter=clutter,
        occluders=_draw_occluders(spec.occluders, positions_m, rng),
        noise_key=(spec.seed, NOISE, index),
    )


def _draw_pose(spec: DatasetSpec, station: Station, rng: np.random.Generator) -> CameraPose:
    """A pose at which a marker in the image's middle has the side asked for.

    A tilt t shrinks it there by cos t for the distance and by sqrt(cos t) for the slant.
    """
    side_px, tilt = draw(rng, spec.markers.side_px), np.radians(draw(rng, spec.camera.tilt_deg))
    toward, yaw = rng.uniform(-np.pi, np.pi, 2)
    camera = station.camera
    height_m = camera.focal_length_px * camera.aspect**0.5 / side_px * np.cos(tilt) ** 1.5
    x, y = rng.uniform(-20, 20, 2)
    about = (float(tilt * np.cos(toward)), float(tilt * np.sin(toward)))
    return CameraPose((float(x), float(y)), float(height_m), float(yaw), about)


def _draw_sensor(model: SensorSpec, psf_px: float, rng: np.random.Generator) -> SensorModel:
    values = {
        name: draw(rng, getattr(model, name))
        for name in ("noise", "shot", "gain", "vignetting", "gradient", "shadow")
    }
    quality = draw_whole(rng, model.jpeg_quality or (100, 100))
    gradient_deg, shadow_deg = rng.uniform(-180, 180, 2)
    return SensorModel(
        **values,
        psf_px=psf_px,
        exposure_s=EXPOSURE_S if model.motion_px[1] else 0.0,
        gradient_deg=gradient_deg,
        shadow_deg=shadow_deg,
        shadow_offset=rng.uniform(-0.8, 0.8),
        shadow_edge=rng.uniform(0.01, 0.2),
        jpeg_quality=None if model.jpeg_quality is None else quality,
    )


def _draw_team(
    spec: DatasetSpec, camera: Camera, pose: CameraPose, rng: np.random.Generator
) -> tuple[IntArray, Array, Array]:
    """Markers at random places of the image, as many of those asked for as fit without touching."""
    model = spec.markers
    known = np.arange(dictionary_size(model.dictionary)) if model.ids is None else np.array(model.ids)
    count = draw_whole(rng, model.count)
    ids, tries = rng.permutation(known)[:count], CANDIDATES * max(count, 1)
    width, height = camera.size_px
    points_px = rng.uniform([-0.5, -0.5], [width - 0.5, height - 0.5], (tries, 2))
    headings = rng.uniform(-np.pi, np.pi, tries)
    image_ground = inverse(homography_image_ground(camera, pose))
    places_m = apply_homography(image_ground, undistort(camera, pose.zoom, points_px))
    card = card_side(model.dictionary)
    whole = _inside(camera, project(camera, pose, corners_m(places_m, headings, card)))
    chosen = _choose_apart(places_m, whole, rng.uniform(size=count) < model.cut, 2**0.5 * card)
    ids = np.sort(ids[: len(chosen)])
    return ids, places_m[chosen], headings[chosen]


def corners_m(positions_m: Array, headings_rad: Array, side_m: float) -> Array:
    """Corners (N, 4, 2) of squares on the ground, in the order of a marker's."""
    offsets = side_m * CORNERS.conj() * np.exp(1j * headings_rad)[:, None]
    return positions_m[:, None] + to_points(offsets)


def _inside(camera: Camera, polygons_px: Array) -> BoolArray:
    """Which polygons (N, K, 2) are wholly in the image (N,)."""
    limit = np.array(camera.size_px) - 0.5
    return np.asarray(((polygons_px >= -0.5) & (polygons_px <= limit)).all(axis=(1, 2)))


def _choose_apart(places_m: Array, whole: BoolArray, cut: BoolArray, apart_m: float) -> IntArray:
    """Indices of places that keep a distance, one for each of `cut`: cut by the border, or whole."""
    free = np.ones(len(places_m), dtype=bool)
    chosen: list[int] = []
    for wanted in cut:
        there = np.flatnonzero(free & (whole != wanted))
        if there.size:
            chosen.append(int(there[0]))
            free &= np.linalg.norm(places_m - places_m[there[0]], axis=1) > apart_m
    return np.array(chosen, dtype=np.int64)


def _draw_occluders(
    model: OccludersSpec, positions_m: Array, rng: np.random.Generator
) -> tuple[OccluderModel, ...]:
    """Something over the rim of some of the markers: discs and squares, one as likely as the other."""
    made = []
    for place in positions_m:
        hit, square, toward, turn = rng.uniform(size=4) * (1.0, 1.0, 2 * np.pi, np.pi / 2)
        radius, level = draw(rng, model.radius_sides), draw(rng, model.level)
        center = place + rng.uniform(0.3, 0.6) * np.array([np.cos(toward), np.sin(toward)])
        if hit >= model.share:
            continue
        if square < 0.5:
            made.append(OccluderModel(center_m=(center[0], center[1]), radius_m=radius, level=level))
            continue
        around = turn + np.pi / 4 + np.pi / 2 * np.arange(4)
        corners = center + radius * 2**0.5 * np.column_stack([np.cos(around), np.sin(around)])
        made.append(OccluderModel(corners_m=[(float(x), float(y)) for x, y in corners], level=level))
    return tuple(made)
