"""World to pixels: marker cards on textured ground, through a camera, onto a noisy sensor."""

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, IntArray, apply_homography
from skyherd.markers import card_side
from skyherd.render.camera import Camera, CameraPose, homography_image_ground, square_m
from skyherd.render.ground import Ground
from skyherd.render.sensor import Sensor
from skyherd.render.sprites import MARGIN_SIGMAS, marker_sprite, size_bucket

PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of a box one pixel wide: the pixel's own aperture, taken as a Gaussian beside the lens's."""


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
        self.sigma_px = float(np.sqrt(psf_px**2 + PIXEL_VARIANCE))
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
        for marker_id, position_m, heading_rad in zip(ids, positions_m, headings_rad, strict=True):
            self._draw_marker(image, homography, int(marker_id), position_m, float(heading_rad))
        return self.sensor.expose(image)

    def _draw_marker(
        self,
        image: npt.NDArray[np.uint8],
        homography: Array,
        marker_id: int,
        position_m: Array,
        heading_rad: float,
    ) -> None:
        """Composite one card over `image`: F + (1 - A) background, within the card's bounding box."""
        card_m = self.side_m * card_side(self.dictionary)
        card_px = apply_homography(homography, square_m([position_m], [heading_rad], card_m))[0]
        box = _clip_box(card_px, MARGIN_SIGMAS * self.sigma_px, image.shape)
        if box is None:
            return
        left, top, right, bottom = box
        edge_px = np.linalg.norm(np.roll(card_px, 1, axis=0) - card_px, axis=1).mean()
        bucket = size_bucket(float(edge_px) / card_side(self.dictionary))
        sprite = marker_sprite(self.dictionary, marker_id, bucket, self.sigma_px, self.black, self.white)
        image_marker = homography @ _ground_marker(position_m, heading_rad, self.side_m)
        sprite_image = sprite.sprite_from_marker() @ np.linalg.inv(image_marker)
        sprite_box = sprite_image @ np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        drawn = _warp(sprite.card_and_cover, sprite_box / sprite_box[2, 2], (right - left, bottom - top))
        region = image[top:bottom, left:right]
        region[...] = np.rint(drawn[..., 0] + (1.0 - drawn[..., 1]) * region)


def _ground_marker(position_m: Array, heading_rad: float, side_m: float) -> Array:
    """Similarity (3, 3) from marker coordinates (forward, left, in sides) to ground metres."""
    c, s = side_m * np.cos(heading_rad), side_m * np.sin(heading_rad)
    return np.array([[c, -s, position_m[0]], [s, c, position_m[1]], [0.0, 0.0, 1.0]])


def _clip_box(
    corners_px: Array, margin_px: float, shape: tuple[int, ...]
) -> tuple[int, int, int, int] | None:
    """Whole-pixel bounding box (left, top, right, bottom) inside the image, or None if outside it."""
    low = np.maximum(np.floor(corners_px.min(axis=0) - margin_px), 0).astype(int)
    high = np.minimum(np.ceil(corners_px.max(axis=0) + margin_px) + 1, [shape[1], shape[0]]).astype(int)
    return None if (low >= high).any() else (int(low[0]), int(low[1]), int(high[0]), int(high[1]))


def _warp(
    sprite: npt.NDArray[np.float32], sprite_image: Array, size_px: tuple[int, int]
) -> npt.NDArray[np.float32]:
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    if np.allclose(sprite_image[2, :2], 0.0, atol=1e-12):
        return np.asarray(cv2.warpAffine(sprite, sprite_image[:2], size_px, flags=flags), dtype=np.float32)
    return np.asarray(cv2.warpPerspective(sprite, sprite_image, size_px, flags=flags), dtype=np.float32)
