"""The ground: a periodic texture, band-limited at every scale it is seen at, with clutter on it.

A texture is kept at several resolutions, each low-passed by the image's own blur at that resolution, so that
drawing it by one warp per image does not alias. The view of a camera that stands still is kept and copied.
"""

from collections import deque
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, Image, apply_homography, inverse
from skyherd.render.scene.clutter import Clutter
from skyherd.render.scene.textures import PERIOD, SLABS, concrete, picture, tiles
from skyherd.render.view import ShapeImages

GroundKind = Literal["plain", "concrete", "tiles", "image"]
KINDS: tuple[GroundKind, ...] = ("plain", "concrete", "tiles", "image")
"""Kinds of ground: one grey level, noise with a 1/f spectrum, square tiles, or a repeated picture."""

FINEST = PERIOD
"""Samples along a period of the finest texture. *Derived*: that in which textures are made."""

COARSEST = 2
"""Samples along a period of the coarsest texture. *Derived*: the least number that has a spectrum to cut."""

SAMPLES_PER_PX = 1.2
"""Samples of the texture that the image's pixels ask for, before rounding down to a power of two. *Chosen*:
between 0.6 and 1.2 samples a pixel; fewer blur the ground, more cost memory, and are hidden by the image's
own blur."""

KEPT = 6
"""Drawn grounds that are kept. *Chosen*: those of so many cameras that stand still; each is as large as an
image."""

VIEW_SAMPLES = 2000
"""Textures are laid side by side until a view of so many samples fits. *Chosen*: larger than usual images; a
warp that has to wrap costs six times as much."""

APART_BYTES = 64
"""Between the end of a texture's row and the next row. *Derived*: rows that are a power of two apart
compete for the same lines of the processor's cache, where a view is turned by about a right angle: a warp of
800x800 then took 4.8 ms in place of 1.6 (*measured*); a line of the cache in between sets them apart."""

AFFINE = 1e-12
"""Homographies whose last row differs from (0, 0, 1) by less are drawn as affine, which costs less.
*Derived*: over images of 1e4 px this moves a sample by 1e-4 px at most."""


class Ground:
    """Endless textured ground, drawn by one warp per image.

    Args:
        seed: of the texture.
        kind: `plain`; `concrete`, noise with a spectrum that falls as 1/f; `tiles`; or `image`.
        mean: grey level.
        contrast: standard deviation, grey levels; for tiles, between them.
        tile_m: period of concrete, width of an image, or side of one tile; metres.
        sigma_px: blur of lens and pixel, in image pixels.
        image: grey picture (height, width) for the kind `image`, repeated, its upper edge to the north.
        clutter: dark quadrilaterals that lie on it.

    Raises:
        InputError: there is no such kind, or an image is given without the kind `image` or the other way
            round.
    """

    def __init__(
        self,
        seed: int,
        *,
        kind: GroundKind = "concrete",
        mean: float = 128.0,
        contrast: float = 12.0,
        tile_m: float = 40.0,
        sigma_px: float = 0.85,
        image: Image | None = None,
        clutter: Clutter | None = None,
    ) -> None:
        if kind not in KINDS or (kind == "image") != (image is not None):
            raise InputError("ground", f"kind {kind!r}", f"one of {', '.join(KINDS)}; image with an image")
        self.mean, self.clutter = mean, clutter
        self.kind: GroundKind = "plain" if kind == "concrete" and contrast <= 0 else kind
        self.period_m = np.full(2, tile_m * (SLABS if kind == "tiles" else 1.0))
        self._sigma_px, texture = sigma_px, None
        self._spectrum: npt.NDArray[np.complex128] | None = None
        if image is not None:
            texture = picture(image)
            self.mean = float(texture.mean())
            self.period_m = tile_m * np.array([1.0, image.shape[0] / image.shape[1]])
        elif self.kind == "concrete":
            self._spectrum = _concrete_spectrum(seed, mean, contrast)
        elif self.kind == "tiles":
            texture = tiles(seed, mean, contrast)
        if texture is not None:
            self._spectrum = np.fft.rfft2(texture)
        self._levels: dict[int, Image] = {}
        self._asked: deque[bytes] = deque(maxlen=KEPT)
        self._drawn: dict[bytes, Image] = {}

    def draw(self, homography: Array, size_px: tuple[int, int]) -> Image:
        """Return the texture as a pinhole camera sees it, without clutter: grey levels (height, width).

        Args:
            homography: (3, 3) from ground metres to pixels.
            size_px: width and height of the image.
        """
        if self.kind == "plain":
            return np.full(size_px[::-1], round(self.mean), dtype=np.uint8)
        key = homography.tobytes() + bytes(str(size_px), "ascii")
        if key in self._drawn:
            return self._drawn[key].copy()
        drawn = _warp(*self._choose(homography, size_px), size_px)
        if key in self._asked:
            if len(self._drawn) == KEPT:
                del self._drawn[next(iter(self._drawn))]
            self._drawn[key] = drawn.copy()
        self._asked.append(key)
        return drawn

    def draw_bent(self, images: ShapeImages) -> Image:
        """Return the texture as seen through lens and rolling shutter: grey levels (height, width).

        `images` are those of the ground itself, in metres (`View.ground`). Each pixel looks up its own
        sample.
        """
        width, height = size = images.camera.size_px
        if self.kind == "plain":
            return self.draw(np.eye(3), size)
        middle = images.row_shapes(np.array([(height - 1) / 2]))[0]
        laid, sample_image = self._choose(inverse(middle), size)
        sample_ground = sample_image @ inverse(middle)
        rows = sample_ground @ images.row_shapes(np.arange(height, dtype=float))
        rows = (rows / (rows[:, 2] @ [width / 2, height / 2, 1.0])[:, None, None]).astype(np.float32)
        v, u = np.mgrid[:height, :width].astype(np.float32)
        lens = images.lens()
        if lens is not None:
            u += lens.fields[0].reshape(height, width)
            v += lens.fields[1].reshape(height, width)
        x, y, w = (rows[:, i, :1] * u + rows[:, i, 1:2] * v + rows[:, i, 2:] for i in range(3))
        return np.asarray(
            cv2.remap(laid, x / w, y / w, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP), dtype=np.uint8
        )

    def _choose(self, homography: Array, size_px: tuple[int, int]) -> tuple[Image, Array]:
        """Return the texture fine enough for a view, and the map (3, 3) from pixels to its samples."""
        width, height = size_px
        image_ground = inverse(homography)
        center = image_ground @ [width / 2, height / 2, 1.0]
        scale = _local_scale(homography, center[:2] / center[2])
        wanted = SAMPLES_PER_PX * scale * float(np.sqrt(self.period_m.prod()))
        samples = COARSEST
        while 2 * samples <= min(wanted, FINEST):
            samples *= 2
        if samples not in self._levels and self._spectrum is not None:
            tile = _band_limited(self._spectrum, samples, self._sigma_px)
            self._levels[samples] = _laid(tile, int(np.ceil(VIEW_SAMPLES / samples)) + 1)
        sample_image = np.diag([*(samples / self.period_m), 1.0]) @ image_ground
        view = apply_homography(sample_image, [[0, 0], [width, 0], [width, height], [0, height]])
        near = np.eye(3)
        near[:2, 2] = -samples * np.floor(view.min(axis=0) / samples)
        return self._levels[samples], near @ sample_image


@lru_cache(maxsize=2)
def _concrete_spectrum(seed: int, mean: float, contrast: float) -> npt.NDArray[np.complex128]:
    """Spectrum (PERIOD, PERIOD // 2 + 1) of concrete, not to be written to.

    The last two are kept: making one takes half a second, and who runs a mission again has the same ground.
    """
    spectrum = np.fft.rfft2(concrete(seed, mean, contrast))
    spectrum.flags.writeable = False
    return spectrum


def _laid(tile: Image, copies: int) -> Image:
    """Return a square texture repeated along either side, with `APART_BYTES` between rows."""
    side = copies * len(tile)
    laid = np.empty((side, side + APART_BYTES), dtype=np.uint8)[:, :side]
    laid.reshape(copies, len(tile), copies, len(tile))[:] = tile[None, :, None, :]
    return laid


def _warp(laid: Image, sample_image: Array, size_px: tuple[int, int]) -> Image:
    """Image of `size_px` whose pixel x is `laid`, repeated, at `sample_image` times x."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    matrix = sample_image / sample_image[2, 2]
    if np.abs(matrix[2, :2]).max() < AFFINE:
        drawn = cv2.warpAffine(laid, matrix[:2], size_px, flags=flags, borderMode=cv2.BORDER_WRAP)
    else:
        drawn = cv2.warpPerspective(laid, matrix, size_px, flags=flags, borderMode=cv2.BORDER_WRAP)
    return np.asarray(drawn, dtype=np.uint8)


def _local_scale(homography: Array, at_m: Array) -> float:
    """Return pixels a metre near one ground point: root of the Jacobian's determinant."""
    w = homography[2] @ [*at_m, 1.0]
    return float(np.sqrt(abs(np.linalg.det(homography)) / abs(w) ** 3))


def _band_limited(spectrum: npt.NDArray[np.complex128], samples: int, sigma: float) -> Image:
    """Return a texture at a resolution of `samples` a period, blurred by sigma samples."""
    fy, fx = np.fft.fftfreq(PERIOD)[:, None] * PERIOD, np.fft.rfftfreq(PERIOD)[None, :] * PERIOD
    half = samples // 2
    rows = np.r_[0:half, PERIOD - half : PERIOD]
    radius = np.hypot(fy[rows], fx[:, : half + 1])
    kept = spectrum[rows, : half + 1] * np.exp(-2 * (np.pi * radius * sigma / samples) ** 2)
    image = np.fft.irfft2(kept, s=(samples, samples)) * (samples / PERIOD) ** 2
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
