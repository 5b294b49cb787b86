"""Draws images: marker cards on textured ground, through a camera, onto a noisy sensor.

Drawn in this order, each over what was before it: ground, clutter, markers, occluders. Motion blur is the
mean of sharp images over the exposure, defocus and coma that over the rays through the lens.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np

from skyherd.geometry import Array, Image, IntArray, apply_homography, inverse
from skyherd.markers.dictionary import card_side, cells_per_side, marker_cells
from skyherd.render.camera.camera import Camera, CameraPose
from skyherd.render.camera.lens_blur import SHARP, LensBlur, Ray
from skyherd.render.camera.motion import INSTANT, STILL, Motion, Shutter
from skyherd.render.ground import Ground
from skyherd.render.paint import Canvas, framed, paint_discs, paint_lattices
from skyherd.render.raster.edge import Float, edge_spread
from skyherd.render.scene.occluders import Disc, Occluder, Quad, quads_square
from skyherd.render.sensor import Sensor
from skyherd.render.truth import FrameTruth, moving_markers, project_markers
from skyherd.render.view import View

Light = Float
"""What falls on the sensor, in grey levels, (height, width)."""

MAX_INSTANTS = 64
"""Sharp images at most whose mean is a blurred one. *Chosen*: right for streaks of up to 120 standard
deviations of blur, some 100 px; longer ones show steps."""


class Renderer:
    """Draws a team of marked robots as a camera would see it, and tells where each marker is.

    The same renderer serves many cameras; pose, robots, motion and occluders are given for each image.

    Args:
        dictionary: marker dictionary, such as `4X4_50`.
        side_m: side of the black square.
        ground: what the robots drive on.
        sensor: what turns light into grey levels.
        psf_px: standard deviation of the lens's Gaussian blur.
        black: grey level of the markers' black.
        white: grey level of the card.
        shutter: exposure and row time: motion blur and rolling shutter.
        lens_blur: defocus and coma, beside the Gaussian.
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
        self._spread = edge_spread(psf_px)
        self._team: tuple[int, ...] = ()
        self._cards = framed(np.zeros((0, 1, 1)))

    def render(
        self,
        camera: Camera,
        pose: CameraPose,
        ids: IntArray,
        positions_m: Array,
        headings_rad: Array,
        *,
        motion: Motion = STILL,
        occluders: Sequence[Occluder] = (),
        stream: int = 0,
    ) -> Image:
        """Draw the image that a camera takes.

        Args:
            camera: intrinsics and lens.
            pose: where the camera is in the middle of the exposure of the middle row.
            ids: (N,) markers of the dictionary.
            positions_m: (N, 2) places of the markers' centres on the ground.
            headings_rad: (N,) their forward directions, counter-clockwise from +x.
            motion: velocities of camera and robots; they matter only with an exposure or a row time.
            occluders: what lies over markers, each over those before it.
            stream: number of the camera's video stream, which matters only to a codec that remembers.

        Returns:
            Grey levels (height, width), with the sensor's noise, which differs from call to call.
        """
        team = (ids, positions_m, headings_rad)
        if self.sensor.linear and self.lens_blur.none and not self.shutter.exposure_s:
            view = View(camera, pose, motion, self.shutter)
            return self.sensor.expose(self._draw(self._ground(view), view, *team, occluders), stream)
        light = self.light(camera, pose, *team, motion=motion, occluders=occluders)
        return self.sensor.expose(light, stream)

    def light(
        self,
        camera: Camera,
        pose: CameraPose,
        ids: IntArray,
        positions_m: Array,
        headings_rad: Array,
        *,
        motion: Motion = STILL,
        occluders: Sequence[Occluder] = (),
    ) -> Light:
        """Draw what falls on the sensor: `render` without the sensor, in grey levels (height, width).

        Nothing is rounded but the ground's texture.

        Motion blur is the mean over the exposure, by Gauss-Legendre quadrature with a sharp image for every
        two standard deviations of blur that anything moves, and two more; defocus and coma are the mean over
        the rays through the lens (`skyherd.render.camera.lens_blur`).
        """
        team = (ids, positions_m, headings_rad)
        total: Light | None = None
        instants = self._instants(camera, pose, positions_m, headings_rad, motion)
        for (at_s, share), (ray, of_share) in product(instants, self._rays(camera, pose)):
            view, weight = View(camera, pose, motion, self.shutter, at_s, ray), share * of_share
            if self.ground.kind == "plain":
                canvas = np.full(camera.size_px[::-1], self.ground.mean, dtype=np.float32)
            else:
                canvas = self._ground(view).astype(np.float32)
            self._draw(canvas, view, *team, occluders)
            canvas *= np.float32(weight)
            total = canvas if total is None else np.add(total, canvas, out=total)
        return np.zeros(camera.size_px[::-1], dtype=np.float32) if total is None else total

    def truth(
        self,
        camera: Camera,
        pose: CameraPose,
        ids: IntArray,
        positions_m: Array,
        headings_rad: Array,
        *,
        motion: Motion = STILL,
        occluders: Sequence[Occluder] = (),
    ) -> FrameTruth:
        """Exact truth about the image that `render` draws with the same arguments."""
        return project_markers(
            camera,
            pose,
            positions_m,
            headings_rad,
            side_m=self.side_m,
            card_side_m=self.side_m * card_side(self.dictionary),
            ids=ids,
            motion=motion,
            shutter=self.shutter,
            occluders=occluders,
        )

    def _instants(
        self, camera: Camera, pose: CameraPose, positions_m: Array, headings_rad: Array, motion: Motion
    ) -> list[tuple[float, float]]:
        """Instants within the exposure, s, and their weights, which sum to one: nodes of Gauss and Legendre.

        How many follows from the longest way, px, that a marker or a corner of the ground in view moves.
        """
        half_s = self.shutter.exposure_s / 2
        if not half_s or motion.still:
            return [(0.0, 1.0)]
        marks = []
        for at_s in (-half_s, half_s):
            view = View(camera, pose, motion, self.shutter, at_s)
            markers = view.images(moving_markers(positions_m, headings_rad, self.side_m, motion))
            homography = view.ground().matrices[0, 0]
            if at_s < 0:
                corners_m = apply_homography(inverse(homography), camera.corners_px)
            forward = markers.project(np.array([[0.0, 0.0], [1.0, 0.0]])).reshape(-1, 2)
            marks.append(np.concatenate([forward, apply_homography(homography, corners_m)]))
        length_px = float(np.linalg.norm(marks[1] - marks[0], axis=1).max())
        count = min(int(np.ceil(length_px / (2 * self._spread.sigma_px))) + 2, MAX_INSTANTS)
        nodes, weights = np.polynomial.legendre.leggauss(count)
        return [(float(x * half_s), float(w / 2)) for x, w in zip(nodes, weights, strict=True)]

    def _rays(self, camera: Camera, pose: CameraPose) -> list[tuple[Ray | None, float]]:
        """Rays through the lens and their weights, which sum to one: the middle one if the lens is sharp."""
        if self.lens_blur.none:
            return [(None, 1.0)]
        return [(ray, ray.weight) for ray in self.lens_blur.rays(camera, pose, self._spread.sigma_px)]

    def _ground(self, view: View) -> Image:
        ground = view.ground()
        if ground.bent:
            return self.ground.draw_bent(ground)
        return self.ground.draw(ground.matrices[0, 0], view.camera.size_px)

    def _draw(
        self,
        canvas: Canvas,
        view: View,
        ids: IntArray,
        positions_m: Array,
        headings_rad: Array,
        occluders: Sequence[Occluder],
    ) -> Canvas:
        """Clutter, markers and occluders over the ground, in this order."""
        if self.ground.clutter is not None:
            low, high = view.ground_box()
            corners_m, levels = self.ground.clutter.within(low, high)
            self._quads(canvas, view, corners_m, levels)
        if len(ids):
            markers = moving_markers(positions_m, headings_rad, self.side_m, view.motion)
            marker_lattice = _marker_lattice(cells_per_side(self.dictionary))
            images = view.images(lambda time_s: markers(time_s) @ marker_lattice)
            paint_lattices(canvas, images, self._levels(ids), self._spread)
        for occluder in occluders:
            if isinstance(occluder, Quad):
                self._quads(canvas, view, np.array([occluder.corners_m]), np.array([occluder.level]))
            else:
                self._disc(canvas, view, occluder)
        return canvas

    def _quads(self, canvas: Canvas, view: View, corners_m: Array, levels: Array) -> None:
        shapes = quads_square(corners_m)
        paint_lattices(canvas, view.images(lambda _: shapes), framed(levels[:, None, None]), self._spread)

    def _disc(self, canvas: Canvas, view: View, disc: Disc) -> None:
        shape = disc.ground_shape()[None]
        paint_discs(canvas, view.images(lambda _: shape), np.array([disc.level]), self._spread)

    def _levels(self, ids: IntArray) -> Float:
        """Levels of markers' cards, framed: row 0 is the forward edge, column 0 the left one.

        The last team's are kept.
        """
        asked = tuple(int(marker_id) for marker_id in ids)
        if self._team != asked:
            cells = np.stack([marker_cells(self.dictionary, marker_id) for marker_id in asked])
            levels = np.where(cells, self.white, self.black)
            around = ((0, 0), (1, 1), (1, 1))
            self._team, self._cards = asked, framed(np.pad(levels, around, constant_values=self.white))
        return self._cards


def _marker_lattice(n: int) -> Array:
    """Map (3, 3) from a card's columns and rows, quiet zone and all, to (forward, left) in sides."""
    middle = n / 2 + 1
    return np.array([[0.0, -1.0, middle], [-1.0, 0.0, middle], [0.0, 0.0, n]])
