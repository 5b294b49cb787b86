"""World to pixels: marker cards on textured ground, through a camera, onto a noisy sensor."""

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray, apply_homography
from skyherd.markers import card_side
from skyherd.optics import total_sigma_px
from skyherd.render.camera import Camera, CameraPose, homography_image_ground, square_m
from skyherd.render.ground import Ground
from skyherd.render.resample import warp
from skyherd.render.sensor import Sensor
from skyherd.render.sprites import MARGIN_SIGMAS, marker_sprite, size_bucket


class Renderer:
    """Draws a team of marked robots as a camera would see it.

    Args:
        dictionary: marker dictionary, such as `4X4_50`.
        side_m: side of the black square.
        ground: what the robots drive on.
        sensor: what turns light into grey levels.
        psf_px: standard deviation of the lens's Gaussian blur.
        black: grey level of the markers' black.
        white: grey level of the card.
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
    ) -> None:
        self.dictionary, self.side_m = dictionary, side_m
        self.ground, self.sensor = ground, sensor
        self.sigma_px = total_sigma_px(psf_px)
        self.black, self.white = black, white

    def render(
        self,
        camera: Camera,
        pose: CameraPose,
        ids: IntArray,
        positions_m: Array,
        headings_rad: Array,
    ) -> npt.NDArray[np.uint8]:
        """Grey image (height, width) of robots `ids` (N,) at positions (N, 2) with headings (N,)."""
        homography = homography_image_ground(camera, pose)
        image = self.ground.draw(homography, camera.size_px)
        cards_m = square_m(positions_m, headings_rad, self.side_m * card_side(self.dictionary))
        cards_px = apply_homography(homography, cards_m)
        sides_px = _mean_edges(cards_px) / card_side(self.dictionary)
        markers_image = np.linalg.inv(homography @ _ground_markers(positions_m, headings_rad, self.side_m))
        for marker_id, card_px, side_px, marker_image in zip(
            ids, cards_px, sides_px, markers_image, strict=True
        ):
            self._draw_marker(image, int(marker_id), card_px, float(side_px), marker_image)
        return self.sensor.expose(image)

    def _draw_marker(
        self,
        image: npt.NDArray[np.uint8],
        marker_id: int,
        card_px: Array,
        side_px: float,
        marker_image: Array,
    ) -> None:
        """Composite one card over `image`: F + (1 - A) background, within the card's bounding box."""
        box = _clip_box(card_px, MARGIN_SIGMAS * self.sigma_px, image.shape)
        if box is None:
            return
        left, top, right, bottom = box
        bucket = size_bucket(side_px)
        sprite = marker_sprite(self.dictionary, marker_id, bucket, self.sigma_px, self.black, self.white)
        sprite_box = sprite.sprite_from_marker() @ marker_image
        sprite_box[:, 2] += sprite_box[:, :2] @ (left, top)
        drawn = warp(sprite.card_and_cover, sprite_box, (right - left, bottom - top))
        region = image[top:bottom, left:right]
        seen = (1.0 - drawn[..., 1]) * region
        seen += drawn[..., 0]
        region[...] = np.rint(seen, out=seen)


def _mean_edges(cards_px: Array) -> Array:
    """Mean edge length (N,) of quadrilaterals (N, 4, 2)."""
    edges = np.roll(cards_px, 1, axis=1) - cards_px
    return np.asarray(np.hypot(edges[..., 0], edges[..., 1]).mean(axis=1))


def _ground_markers(positions_m: Array, headings_rad: Array, side_m: float) -> Array:
    """Similarities (N, 3, 3) from marker coordinates (forward, left, in sides) to ground metres."""
    c, s = side_m * np.cos(headings_rad), side_m * np.sin(headings_rad)
    ground = np.zeros((len(headings_rad), 3, 3))
    ground[:, 0, 0] = ground[:, 1, 1] = c
    ground[:, 1, 0], ground[:, 0, 1] = s, -s
    ground[:, :2, 2], ground[:, 2, 2] = positions_m, 1.0
    return ground


def _clip_box(
    corners_px: Array, margin_px: float, shape: tuple[int, ...]
) -> tuple[int, int, int, int] | None:
    """Whole-pixel bounding box (left, top, right, bottom) inside the image, or None if outside it."""
    low = np.maximum(np.floor(corners_px.min(axis=0) - margin_px), 0).astype(int)
    high = np.minimum(np.ceil(corners_px.max(axis=0) + margin_px) + 1, [shape[1], shape[0]]).astype(int)
    return None if (low >= high).any() else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))
