"""Renderer of marker cards on textured ground, through a camera, with sensor noise.

Drawing order: ground, clutter, markers, occluders. Motion blur is the mean of sharp images over the exposure.
Defocus and coma are the mean over rays through the pupil.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from skyherd.geometry import Array, Image, IntArray, apply_homography, inverse
from skyherd.markers.dictionary import card_side, cells_per_side, marker_cells
from skyherd.render.camera.lens_blur import SHARP, LensBlur, Ray
from skyherd.render.camera.motion import INSTANT, Shutter
from skyherd.render.edge import EdgeSpread, Float, edge_spread
from skyherd.render.ground import Ground
from skyherd.render.native.library import Canvas
from skyherd.render.paint import framed, paint_discs, paint_lattices
from skyherd.render.scene.occluders import Disc, Quad, quads_square
from skyherd.render.sensor import Sensor
from skyherd.render.shot import Imaging, Shot
from skyherd.render.truth import FrameTruth, moving_markers, project_markers
from skyherd.render.view import View

Light = Float
"""Light on the sensor, in grey levels, (height, width)."""

MAX_INSTANTS = 64
"""Maximum number of sharp images per motion-blurred image. *Chosen*: sufficient for streaks of up to 120
standard deviations of blur, about 100 px; longer ones show steps."""


class Renderer:
    """Renderer of camera images of a team of marked robots, with ground truth, for any number of cameras.

    Args:
        dictionary: marker dictionary, such as `4X4_50`.
        side_m: side of the black square.
        ground: ground with its clutter.
        sensor: model from light to grey levels.
        psf_px: standard deviation of the lens's Gaussian blur.
        black: grey level of the markers' black.
        white: grey level of the card.
        shutter: exposure and row time: motion blur and rolling shutter.
        lens_blur: defocus and coma, besides the Gaussian.
    """

    def __init__(
        self,
        dictionary: str,
        side_m: float,
        ground: Ground,
        sensor: Sensor,
        *,
        psf_px: float = 0.8,
        black: float = 30.0,
        white: float = 230.0,
        shutter: Shutter = INSTANT,
        lens_blur: LensBlur = SHARP,
    ) -> None:
        self.dictionary, self.side_m = dictionary, side_m
        self.ground, self.sensor, self.shutter = ground, sensor, shutter
        self.psf_px, self.black, self.white, self.lens_blur = psf_px, black, white, lens_blur
        self._varied: dict[int, tuple[Imaging, Sensor]] = {}
        self._team: tuple[int, ...] = ()
        self._cards = framed(np.zeros((0, 1, 1)))

    def render(self, shot: Shot) -> Image:
        """Render the camera image of a shot.

        Returns:
            Grey levels (height, width), with sensor noise that differs in each call.
        """
        sensor = self._sensor_of(shot)
        if sensor.linear and self.lens_blur.none and not self._shutter_of(shot).exposure_s:
            view = self._view(shot)
            return sensor.expose(self._draw(self._ground(view), view, shot), shot.stream)
        return sensor.expose(self.light(shot), shot.stream)

    def skip(self, shot: Shot) -> None:
        """Draw the random numbers of `render` without an image; see `Sensor.skip`."""
        self._sensor_of(shot).skip(shot.camera.size_px)

    def light(self, shot: Shot) -> Light:
        """Render the light on the sensor: `render` without the sensor, in grey levels (height, width).

        Only the ground's texture is rounded. Motion blur is the mean over the exposure, by Gauss–Legendre
        quadrature. It has a node for every two standard deviations of blur of the longest motion, and two
        more. Defocus and coma are the mean over rays through the pupil (`skyherd.render.camera.lens_blur`).
        """
        ground, size_px = self.ground, shot.camera.size_px[::-1]
        total: Light | None = None
        for (at_s, share), (ray, of_share) in product(self._instants(shot), self._rays(shot)):
            view, weight = self._view(shot, at_s, ray), share * of_share
            if ground.kind == "plain":
                canvas = np.full(size_px, ground.mean, dtype=np.float32)
            else:
                canvas = self._ground(view).astype(np.float32)
            self._draw(canvas, view, shot)
            canvas *= np.float32(weight)
            total = canvas if total is None else np.add(total, canvas, out=total)
        return np.zeros(size_px, dtype=np.float32) if total is None else total

    def truth(self, shot: Shot) -> FrameTruth:
        """Return the exact ground truth of the image that `render` draws of the same shot."""
        return project_markers(
            shot.camera,
            shot.pose,
            shot.positions_m,
            shot.headings_rad,
            side_m=self.side_m,
            card_side_m=self.side_m * card_side(self.dictionary),
            ids=shot.ids,
            frames=shot.frames,
            motion=shot.motion,
            shutter=self._shutter_of(shot),
            occluders=shot.occluders,
        )

    def _view(self, shot: Shot, at_s: float = 0.0, ray: Ray | None = None) -> View:
        return View(shot.camera, shot.pose, shot.motion, self._shutter_of(shot), at_s, ray)

    def _shutter_of(self, shot: Shot) -> Shutter:
        """Return the shutter of the shot's camera."""
        exposure_s = shot.imaging.exposure_s
        return self.shutter if exposure_s is None else replace(self.shutter, exposure_s=exposure_s)

    def _spread_of(self, shot: Shot) -> EdgeSpread:
        """Return the edge spread of the shot's camera."""
        return edge_spread(self.psf_px if shot.imaging.psf_px is None else shot.imaging.psf_px)

    def _sensor_of(self, shot: Shot) -> Sensor:
        """Return the sensor of the shot's camera; the last one of each camera is kept, with its noise."""
        imaging, sensor = shot.imaging, self.sensor
        if imaging.noise is None and imaging.gain is None:
            return sensor
        if self._varied.get(shot.stream, (None,))[0] != imaging:
            noise = sensor.noise if imaging.noise is None else imaging.noise
            gain = sensor.gain if imaging.gain is None else imaging.gain
            self._varied[shot.stream] = imaging, sensor.varied(noise, gain)
        return self._varied[shot.stream][1]

    def _instants(self, shot: Shot) -> list[tuple[float, float]]:
        """Return the Gauss–Legendre nodes of the exposure, s, and their weights, which sum to one.

        Their number follows from the longest motion, px, of a marker or of the ground at an image corner.
        """
        half_s, motion = self._shutter_of(shot).exposure_s / 2, shot.motion
        if not half_s or motion.still:
            return [(0.0, 1.0)]
        marks = []
        for at_s in (-half_s, half_s):
            view = self._view(shot, at_s)
            markers = view.images(self._markers(shot))
            homography = view.ground().matrices[0, 0]
            if at_s < 0:
                corners_m = apply_homography(inverse(homography), shot.camera.corners_px)
            forward = markers.project(np.array([[0.0, 0.0], [1.0, 0.0]])).reshape(-1, 2)
            marks.append(np.concatenate([forward, apply_homography(homography, corners_m)]))
        length_px = float(np.linalg.norm(marks[1] - marks[0], axis=1).max())
        count = min(int(np.ceil(length_px / (2 * self._spread_of(shot).sigma_px))) + 2, MAX_INSTANTS)
        nodes, weights = np.polynomial.legendre.leggauss(count)
        return [(float(x * half_s), float(w / 2)) for x, w in zip(nodes, weights, strict=True)]

    def _rays(self, shot: Shot) -> list[tuple[Ray | None, float]]:
        """Return rays through the pupil and their weights, which sum to one; the central one if sharp."""
        blur = self.lens_blur
        if blur.none:
            return [(None, 1.0)]
        sigma_px = self._spread_of(shot).sigma_px
        return [(ray, ray.weight) for ray in blur.rays(shot.camera, shot.pose, sigma_px)]

    def _ground(self, view: View) -> Image:
        ground = view.ground()
        if ground.bent:
            return self.ground.draw_bent(ground)
        return self.ground.draw(ground.matrices[0, 0], view.camera.size_px)

    def _markers(self, shot: Shot) -> Callable[[float], Array]:
        """Return the maps from markers to the ground, by the time of a row."""
        return moving_markers(
            shot.pose, shot.positions_m, shot.headings_rad, self.side_m, shot.motion, shot.frames
        )

    def _draw(self, canvas: Canvas, view: View, shot: Shot) -> Canvas:
        """Draw clutter, markers and occluders over the ground, in this order."""
        clutter, spread = self.ground.clutter, self._spread_of(shot)
        if clutter is not None:
            low, high = view.ground_box()
            corners_m, levels = clutter.within(low, high)
            self._quads(canvas, view, corners_m, levels, spread)
        if len(shot.ids):
            markers = self._markers(shot)
            marker_lattice = _marker_lattice(cells_per_side(self.dictionary))
            images = view.images(lambda time_s: markers(time_s) @ marker_lattice)
            paint_lattices(canvas, images, self._levels(shot.ids), spread)
        for occluder in shot.occluders:
            if isinstance(occluder, Quad):
                self._quads(canvas, view, np.array([occluder.corners_m]), np.array([occluder.level]), spread)
            else:
                self._disc(canvas, view, occluder, spread)
        return canvas

    def _quads(self, canvas: Canvas, view: View, corners_m: Array, levels: Array, spread: EdgeSpread) -> None:
        shapes = quads_square(corners_m)
        paint_lattices(canvas, view.images(lambda _: shapes), framed(levels[:, None, None]), spread)

    def _disc(self, canvas: Canvas, view: View, disc: Disc, spread: EdgeSpread) -> None:
        shape = disc.ground_shape()[None]
        paint_discs(canvas, view.images(lambda _: shape), np.array([disc.level]), spread)

    def _levels(self, ids: IntArray) -> Float:
        """Return the grey levels of marker cards, `framed`; row 0 is the forward edge, column 0 the left one.

        Those of the last ids are cached.
        """
        asked = tuple(np.asarray(ids).tolist())
        if self._team != asked:
            cells = np.stack([marker_cells(self.dictionary, marker_id) for marker_id in asked])
            levels = np.where(cells, self.white, self.black)
            around = ((0, 0), (1, 1), (1, 1))
            self._team, self._cards = asked, framed(np.pad(levels, around, constant_values=self.white))
        return self._cards


def _marker_lattice(n: int) -> Array:
    """Return the map (3, 3) from columns and rows of a card, with quiet zone, to (forward, left) in sides."""
    middle = n / 2 + 1
    return np.array([[0.0, -1.0, middle], [-1.0, 0.0, middle], [0.0, 0.0, n]])
