"""Frames with ground truth, rendered by `skyherd.render`: the common images of all detectors.

A different source (`FrameSource`) may yield `LabelledFrame`s for a cell, a dictionary and a seed instead.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.scene import PlannedShot, camera_shots, covering_discs, touching_squares
from skyherd.geometry import UNIFORM_VARIANCE, Array, BoolArray, IntArray
from skyherd.markers.blur_model import total_sigma_px
from skyherd.markers.cramer_rao import pose_covariances
from skyherd.render import (
    Clutter,
    Disc,
    FrameTruth,
    Ground,
    Illumination,
    LensBlur,
    Mosaic,
    Motion,
    Processing,
    Quad,
    Renderer,
    Sensor,
    Shot,
    Shutter,
    footprint_m,
)

EXPOSURE_S = 0.01
"""Exposure of images with motion blur, s. The cell sets the length of the streak; the exposure sets only the
camera's speed."""

GOLDEN_ANGLE_RAD = np.pi * (3.0 - 5.0**0.5)
"""Angle between coma directions of consecutive cameras, rad: they fill the circle for any number."""

MIN_BLUR_PX = 0.05
"""Minimum blur of the bound's lens, px. *Chosen*: as narrow as the renderer draws; the pixel hides it."""

QUAD_SIDES = (0.4, 1.2)
"""Least and greatest side of clutter, in marker sides."""


@dataclass(frozen=True)
class LabelledFrame:
    """One image and its ground truth.

    Attributes:
        image: grey, (height, width).
        unit_id: the camera.
        time_s: time of the image.
        ids: (N,) markers in view.
        centers_px: (N, 2) images of their centres.
        headings_rad: (N,) directions of their forward axes there.
        sides_px: (N,) their sides.
        whole: (N,) True if marker and card are inside the image, so that a detector should find it.
        bounds: (N, 3, 3) Cramér–Rao bound of (u, v, heading).
        blur_px: standard deviation of the lens's blur.
    """

    image: npt.NDArray[np.uint8]
    unit_id: int
    time_s: float
    ids: IntArray
    centers_px: Array
    headings_rad: Array
    sides_px: Array
    whole: BoolArray
    bounds: Array
    blur_px: float


class FrameSource(Protocol):
    """Function that makes the frames of a cell; the same arguments give the same frames, to the bit."""

    def __call__(self, cell: Cell, dictionary: str, seed: int) -> Iterator[LabelledFrame]:
        """Yield the frames of all cameras of the cell, camera by camera, each in the order of time.

        Args:
            cell: the condition.
            dictionary: dictionary of the markers.
            seed: seed of all random draws.
        """
        ...


def rendered_frames(cell: Cell, dictionary: str, seed: int) -> Iterator[LabelledFrame]:
    """Yield the frames of a cell, rendered; a `FrameSource`."""
    if cell.shrink != 1.0:
        large = replace(cell, side_px=cell.side_px * cell.shrink, shrink=1.0)
        yield from (shrunk(frame, cell.shrink) for frame in rendered_frames(large, dictionary, seed))
        return
    for unit in range(cell.cameras):
        layout, rng, noise = (np.random.default_rng([seed, unit, use]) for use in range(3))
        toward = rng.uniform(-np.pi, np.pi)
        light = Illumination(gradient=cell.uneven, gradient_rad=toward)
        # The gain takes off what the brightest border has in excess, so that white stays within 8 bits.
        sensor = Sensor(
            cell.noise,
            noise,
            gain=1.0 / (1.0 + cell.uneven / 2.0),
            illumination=light,
            jpeg_quality=cell.jpeg,
            processing=_processing(cell),
        )
        renderer: Renderer | None = None
        for shot in camera_shots(cell, dictionary, unit, layout):
            renderer = renderer or _renderer(cell, dictionary, shot, sensor)
            yield _expose(cell, shot, renderer, rng)


def shrunk(frame: LabelledFrame, shrink: float) -> LabelledFrame:
    """Return a frame downscaled by means over boxes of `shrink` by `shrink` pixels.

    The size is rounded up to whole pixels, and the image is padded with its last rows and columns. A point u
    moves to `(u + 1/2) / shrink - 1/2`. The bound stays that of the original pixels.
    """
    height, width = (math.ceil(length / shrink) for length in frame.image.shape)
    more = (
        math.ceil(size * shrink) - had for size, had in zip((height, width), frame.image.shape, strict=True)
    )
    padded = np.pad(frame.image.astype(np.float64), [(0, count) for count in more], mode="edge")
    image = _box_means(_box_means(padded, shrink, height).T, shrink, width).T
    per_pixel = np.diag([1 / shrink, 1 / shrink, 1.0])
    return replace(
        frame,
        image=np.rint(image).astype(np.uint8),
        centers_px=(frame.centers_px + 0.5) / shrink - 0.5,
        sides_px=frame.sides_px / shrink,
        bounds=per_pixel @ frame.bounds @ per_pixel,
        blur_px=frame.blur_px / shrink,
    )


def _box_means(values: Array, shrink: float, count: int) -> Array:
    """Return means (count, K) over `shrink` rows each of values (L, K), rows weighted by their share."""
    sums = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    at = np.minimum(shrink * np.arange(count + 1), len(values))
    whole = np.minimum(at.astype(int), len(values) - 1)
    upto = sums[whole] + (at - whole)[:, None] * values[whole]
    return np.asarray(np.diff(upto, axis=0) / shrink)


def _mosaic(cell: Cell) -> Mosaic:
    """Return the colour filters of a cell's cameras."""
    return Mosaic("edge-aware", cell.white_balance, cell.white_balance) if cell.white_balance else Mosaic()


def _processing(cell: Cell) -> Processing:
    """Return the image processing of a cell's cameras, except JPEG."""
    return Processing(
        mosaic=_mosaic(cell),
        gamma=cell.gamma,
        denoise=cell.denoise,
        sharpen=cell.sharpen,
        h264_crf=cell.h264,
    )


def lens_blur(cell: Cell, shot: PlannedShot) -> LensBlur:
    """Return defocus and coma of a camera, with the image's centre in focus.

    The aperture follows from the requested disc in the image corner that is farthest out of focus. The coma's
    direction is the camera's own, by the golden angle.
    """
    blur = LensBlur(cell.disc_px, cell.coma_px, coma_rad=GOLDEN_ANGLE_RAD * shot.unit_id)
    if not cell.defocus_px:
        return blur
    focus_m = shot.pose.height_m / np.prod(np.cos(shot.pose.tilt_rad))
    wide_open = LensBlur(aperture_m=1.0, focus_m=float(focus_m))
    radii_px = wide_open.radii_px(shot.camera, shot.pose, shot.camera.corners_px)
    return replace(
        blur, aperture_m=cell.defocus_px / float(np.abs(radii_px).max()), focus_m=wide_open.focus_m
    )


def _renderer(cell: Cell, dictionary: str, shot: PlannedShot, sensor: Sensor) -> Renderer:
    clutter = None
    if cell.clutter:
        density = cell.clutter / _area(footprint_m(shot.camera, shot.pose))
        clutter = Clutter(shot.unit_id, density, QUAD_SIDES)
    return Renderer(
        dictionary,
        1.0,
        _ground(shot.unit_id, total_sigma_px(shot.blur_px), clutter, cell.ground, cell.plain),
        sensor,
        psf_px=shot.blur_px,
        black=cell.black,
        white=cell.white,
        shutter=Shutter(exposure_s=EXPOSURE_S if cell.motion_px else 0.0),
        lens_blur=lens_blur(cell, shot),
    )


@lru_cache(maxsize=6)
def _ground(seed: int, sigma_px: float, clutter: Clutter | None, mean: float, plain: bool) -> Ground:
    """Return the ground of a camera; cached, since it is slow to make and used in every cell."""
    kind: Literal["plain", "concrete"] = "plain" if plain else "concrete"
    return Ground(seed, kind=kind, mean=mean, sigma_px=sigma_px, clutter=clutter)


def _area(corners: Array) -> float:
    """Return the area of a polygon (K, 2)."""
    x, y = corners.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def _expose(cell: Cell, shot: PlannedShot, renderer: Renderer, rng: np.random.Generator) -> LabelledFrame:
    motion, team = _shake(cell, shot, rng), (shot.ids, shot.positions_m, shot.headings_rad)
    around: list[Disc | Quad] = [*covering_discs(cell, shot, rng), *touching_squares(cell, shot)]
    bare = Shot(shot.camera, shot.pose, *team, motion=motion)
    image = renderer.render(replace(bare, occluders=around))
    truth = renderer.truth(bare)
    spread = renderer.lens_blur.variances_px2(shot.camera, shot.pose, truth.centers_px)
    blur_px = float(np.sqrt(shot.blur_px**2 + spread.mean())) if len(spread) else shot.blur_px
    bounds = marker_bounds(cell, renderer.dictionary, blur_px, truth)
    sensor = renderer.sensor
    if not sensor.illumination.even:
        at = np.rint(truth.centers_px).astype(int)
        light = sensor.gain * sensor.illumination.of(shot.camera.size_px)[at[:, 1], at[:, 0]].astype(float)
        bounds = bounds / light[:, None, None] ** 2
    return make_frame(shot, image, truth, bounds)


def make_frame(
    shot: PlannedShot, image: npt.NDArray[np.uint8], truth: FrameTruth, bounds: Array
) -> LabelledFrame:
    """Assemble a frame from a shot, its image, its truth, and the bounds (N, 3, 3) of its markers.

    Occluded markers count as whole: a detector should find them.
    """
    return LabelledFrame(
        image=image,
        unit_id=shot.unit_id,
        time_s=shot.time_s,
        ids=truth.ids,
        centers_px=truth.centers_px,
        headings_rad=truth.headings_rad,
        sides_px=truth.sides_px,
        whole=truth.whole,
        bounds=bounds,
        blur_px=shot.blur_px,
    )


def marker_bounds(cell: Cell, dictionary: str, blur_px: float, truth: FrameTruth) -> Array:
    """Return Cramér–Rao bounds (N, 3, 3) on u, v (px) and heading (rad) of an image's markers.

    Rounding to grey levels adds a variance of 1/12 to the noise, and colour filters reduce the pixels'
    information. A streak of length L has the variance L² / 12 along its direction; averaged over both axes
    that adds L² / 24 to the variance of the blur. Later processing in the camera is ignored.

    Args:
        cell: the condition.
        dictionary: dictionary of the markers.
        blur_px: standard deviation of the lens's blur. Discs and coma count as Gaussian, spatially varying
            blur as its mean.
        truth: ground truth of the image.
    """
    noise = float(np.hypot(cell.noise / _mosaic(cell).information ** 0.5, UNIFORM_VARIANCE**0.5))
    return pose_covariances(
        dictionary,
        truth.ids,
        truth.images_marker,
        psf_px=max(float(np.hypot(blur_px, cell.motion_px / 24**0.5)), MIN_BLUR_PX),
        noise=noise,
        black=cell.black,
        white=cell.white,
        ground=cell.ground,
    )


def _shake(cell: Cell, shot: PlannedShot, rng: np.random.Generator) -> Motion:
    """Return a camera motion with streaks of `motion_px` in a random direction."""
    toward = rng.uniform(-np.pi, np.pi)
    speed = cell.motion_px / EXPOSURE_S * shot.pose.height_m / shot.camera.focal_px
    return Motion(camera_mps=(float(speed * np.cos(toward)), float(speed * np.sin(toward)), 0.0))
