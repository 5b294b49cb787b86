"""Random scenes from a spec, each from seed and number alone.

Random streams have the keys `[seed, use, number]`, so that an image does not depend on process or order.
"""

from functools import lru_cache

import numpy as np

from skyherd.datasets.configuration.camera_models import CameraModel, DistortionModel
from skyherd.datasets.configuration.scene_models import (
    GroundModel,
    LensBlurModel,
    OccluderModel,
    ProcessingModel,
    SensorModel,
)
from skyherd.datasets.labelled.camera_specs import LensBlurSpec, ProcessingSpec, SensorSpec
from skyherd.datasets.labelled.ranges import draw_integer, draw_number
from skyherd.datasets.labelled.scene_specs import OccludersSpec
from skyherd.datasets.labelled.scenes import Scene, Station, corners_m
from skyherd.datasets.labelled.spec import DatasetSpec
from skyherd.datasets.random_streams import LabelledSetStream, generator
from skyherd.geometry import Array, BoolArray, IntArray, apply_homography, inverse
from skyherd.markers.dictionary import card_side, dictionary_size
from skyherd.render import Camera, CameraPose, Motion, homography_image_ground, project, undistort

EXPOSURE_S = 0.01
"""Exposure of images with motion blur, s. Chosen: arbitrary. The spec gives the length of the streak, and the
camera's speed follows from it, so that the exposure cancels."""

CANDIDATES = 60
"""Number of random positions tried per marker. Chosen: it fills images well."""


def station_number(spec: DatasetSpec, index: int) -> int:
    """Return the number of the camera that takes an image, given by its number."""
    return int(generator(spec.seed, LabelledSetStream.IMAGE, index).integers(spec.cameras))


@lru_cache(maxsize=64)
def make_station(spec_json: str, number: int) -> Station:
    """Draw one of the cameras of a set and its ground.

    The argument `spec_json` is hashable, so that the last 64 stations are cached.
    """
    spec = DatasetSpec.model_validate_json(spec_json)
    rng = generator(spec.seed, LabelledSetStream.CAMERA, number)
    lens = {name: draw_number(rng, span) for name, span in spec.camera.distortion}
    camera = CameraModel(
        size_px=spec.size_px,
        half_angle_deg=draw_number(rng, spec.camera.half_angle_deg),
        aspect=draw_number(rng, spec.camera.aspect),
        distortion=DistortionModel(**lens),
    )
    psf_px, model = draw_number(rng, spec.camera.psf_px), spec.ground
    choice = int(rng.integers(len(model.kinds) + len(model.images)))
    level = {"mean": draw_number(rng, model.mean), "contrast": draw_number(rng, model.contrast)}
    tile_m, width_m = draw_number(rng, model.tile_sides), draw_number(rng, model.image_sides)
    if choice >= len(model.kinds):
        ground = GroundModel(
            kind="image", image=model.images[choice - len(model.kinds)], tile_m=width_m, **level
        )
    else:
        kind = model.kinds[choice]
        ground = GroundModel(kind=kind, tile_m=tile_m if kind == "tiles" else None, **level)
    return Station(
        number=number, camera=camera, psf_px=psf_px, ground=ground, ground_seed=int(rng.integers(2**31))
    )


def make_scene(spec: DatasetSpec, index: int) -> Scene:
    """Draw the scene of one image of a set, given by its number."""
    rng = generator(spec.seed, LabelledSetStream.IMAGE, index)
    station = make_station(spec.model_dump_json(), int(rng.integers(spec.cameras)))
    pose = _draw_pose(spec, station, rng)
    motion_px, sensor = (
        draw_number(rng, spec.sensor.motion_px),
        _draw_sensor(spec.sensor, station.psf_px, rng),
    )
    camera_rng = generator(spec.seed, LabelledSetStream.PROCESSING, index)
    lens_blur = _draw_lens_blur(spec.sensor.lens_blur, pose, camera_rng)
    processing = _draw_processing(spec.sensor.processing, camera_rng)
    toward, speed = rng.uniform(-np.pi, np.pi), motion_px / EXPOSURE_S * pose.height_m
    speed /= station.camera.focal_length_px
    black, white = draw_number(rng, spec.markers.black), draw_number(rng, spec.markers.white)
    clutter = draw_integer(rng, spec.ground.clutter)
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
        sensor=sensor.model_copy(update={"lens_blur": lens_blur, "processing": processing}),
        motion_px=motion_px,
        motion=Motion(camera_mps=(float(speed * np.cos(toward)), float(speed * np.sin(toward)), 0.0)),
        clutter=clutter,
        occluders=_draw_occluders(spec.occluders, positions_m, rng),
        noise_key=(spec.seed, int(LabelledSetStream.NOISE), index),
    )


def _draw_pose(spec: DatasetSpec, station: Station, rng: np.random.Generator) -> CameraPose:
    """Draw a pose at which a marker in the image's middle has a drawn side.

    A tilt t reduces the side there by cos t for the distance, and by sqrt(cos t) for the slant.
    """
    side_px, tilt = draw_number(rng, spec.markers.side_px), np.radians(draw_number(rng, spec.camera.tilt_deg))
    toward, yaw = rng.uniform(-np.pi, np.pi, 2)
    camera = station.camera
    height_m = camera.focal_length_px * camera.aspect**0.5 / side_px * np.cos(tilt) ** 1.5
    x, y = rng.uniform(-20, 20, 2)
    about = (float(tilt * np.cos(toward)), float(tilt * np.sin(toward)))
    return CameraPose(
        position_m=(float(x), float(y)), height_m=float(height_m), yaw_rad=float(yaw), tilt_rad=about
    )


def _draw_sensor(model: SensorSpec, psf_px: float, rng: np.random.Generator) -> SensorModel:
    values = {
        name: draw_number(rng, getattr(model, name))
        for name in ("noise", "shot", "gain", "vignetting", "gradient", "shadow")
    }
    quality = draw_integer(rng, model.jpeg_quality or (100, 100))
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


def _draw_lens_blur(model: LensBlurSpec, pose: CameraPose, rng: np.random.Generator) -> LensBlurModel:
    """Draw defocus and coma; the focus distance is relative to the distance of the image's middle."""
    disc, coma, aperture, focus = (draw_number(rng, span) for _, span in model)
    middle_m = pose.height_m / float(np.prod(np.cos(pose.tilt_rad)))
    return LensBlurModel(
        disc_px=disc,
        coma_px=coma,
        coma_deg=rng.uniform(-180, 180),
        aperture_m=aperture,
        focus_m=focus * middle_m,
    )


def _draw_processing(model: ProcessingSpec, rng: np.random.Generator) -> ProcessingModel:
    """Draw the image processing of a camera."""
    names = ("red_gain", "blue_gain", "gamma", "s_curve", "denoise", "sharpen", "sharpen_px")
    values = {name: draw_number(rng, getattr(model, name)) for name in names}
    factor = draw_integer(rng, model.h264_crf or (0, 0))
    return ProcessingModel(
        demosaic=model.demosaic, **values, h264_crf=None if model.h264_crf is None else factor
    )


def _draw_team(
    spec: DatasetSpec, camera: Camera, pose: CameraPose, rng: np.random.Generator
) -> tuple[IntArray, Array, Array]:
    """Draw markers at random positions of the image, as many of the drawn number as fit without contact."""
    model = spec.markers
    known = np.arange(dictionary_size(model.dictionary)) if model.ids is None else np.array(model.ids)
    count = draw_integer(rng, model.count)
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


def _inside(camera: Camera, polygons_px: Array) -> BoolArray:
    """Return the mask (N,) of the polygons (N, K, 2) that are wholly in the image."""
    limit = np.array(camera.size_px) - 0.5
    return np.asarray(((polygons_px >= -0.5) & (polygons_px <= limit)).all(axis=(1, 2)))


def _choose_apart(places_m: Array, whole: BoolArray, cut: BoolArray, apart_m: float) -> IntArray:
    """Choose indices of positions that keep a distance: one per item of `cut`, cut by the border or whole."""
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
    """Draw discs and squares, equally likely, over the rims of some of the markers."""
    made = []
    for place in positions_m:
        hit, square, toward, turn = rng.uniform(size=4) * (1.0, 1.0, 2 * np.pi, np.pi / 2)
        radius, level = draw_number(rng, model.radius_sides), draw_number(rng, model.level)
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
