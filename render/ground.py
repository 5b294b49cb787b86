"""Ground: a periodic texture, band-limited at each scale, with clutter on it.

A texture is stored at several resolutions (a mipmap). Each is low-passed by the image's blur at that
resolution, so that bilinear sampling does not alias. The view of a camera at rest is cached.
"""

from collections import deque
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from skyherd.errors import InputError
from skyherd.geometry import Array, Image, inverse
from skyherd.render.native.library import Frame, library
from skyherd.render.scene.clutter import Clutter
from skyherd.render.scene.textures import PERIOD, SLABS, concrete_spectrum, picture, tiles
from skyherd.render.view import ShapeImages

GroundKind = Literal["plain", "concrete", "tiles", "image"]
KINDS: tuple[GroundKind, ...] = ("plain", "concrete", "tiles", "image")
"""Kinds of ground: uniform grey, noise with a 1/f spectrum, square tiles, or a repeated picture."""

FINEST = PERIOD
"""Samples per period of the finest texture. *Derived*: the resolution of the generated textures."""

COARSEST = 2
"""Samples per period of the coarsest texture. *Derived*: the smallest number with a spectrum to truncate."""

SAMPLES_PER_PX = 1.2
"""Texture samples per pixel, before rounding down to a power of two. *Chosen*: results in 0.6 to 1.2 samples
per pixel. Fewer blur the ground; more cost memory, and the image's blur hides them."""

KEPT = 6
"""Number of cached ground images. *Chosen*: one for each of six cameras at rest; each is as large as an
image."""

APART = 32
"""Additional columns of a texture, at least one. *Chosen*: 64 bytes, one cache line; rows a power of two
apart evict each other in views rotated by 90 degrees."""


class Ground:
    """Endless textured ground.

    Args:
        seed: seed of the texture.
        kind: `plain`; `concrete`, noise with a 1/f spectrum; `tiles`; or `image`.
        mean: mean grey level.
        contrast: standard deviation, grey levels; for tiles, that between tiles.
        tile_m: period of concrete, width of an image, or side of one tile; metres.
        sigma_px: blur of lens and pixel, in image pixels.
        image: grey picture (height, width) for the kind `image`, repeated, its upper edge to the north.
        clutter: dark quadrilaterals on the ground; None for none.

    Raises:
        InputError: the kind is unknown, or not exactly one of the kind `image` and an image is given.
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
        """Return the pinhole image (height, width) of the texture without clutter, in grey levels.

        Args:
            homography: (3, 3) from ground metres to pixels.
            size_px: width and height of the image.
        """
        if self.kind == "plain":
            return np.full(size_px[::-1], round(self.mean), dtype=np.uint8)
        key = homography.tobytes() + bytes(str(size_px), "ascii")
        if key in self._drawn:
            return self._drawn[key].copy()
        ground_image = inverse(homography)
        texture, sample_ground = self._choose(homography, ground_image, size_px)
        frame, matrices = Frame(np.zeros(size_px[1])), (sample_ground @ ground_image)[None]
        drawn = library().draw_ground(size_px, frame, matrices, texture)
        if key in self._asked:
            if len(self._drawn) == KEPT:
                del self._drawn[next(iter(self._drawn))]
            self._drawn[key] = drawn.copy()
        self._asked.append(key)
        return drawn

    def draw_bent(self, images: ShapeImages) -> Image:
        """Return the image (height, width) of the texture through lens and rolling shutter, in grey levels.

        Args:
            images: images of the ground in metres (`View.ground`).
        """
        size_px = images.camera.size_px
        if self.kind == "plain":
            return self.draw(np.eye(3), size_px)
        ground_images, middle = inverse(images.matrices[:, 0]), len(images.matrices) // 2
        texture, sample_ground = self._choose(images.matrices[middle, 0], ground_images[middle], size_px)
        matrices = sample_ground @ ground_images
        return library().draw_ground(size_px, images.frame(), matrices, texture)

    def _choose(
        self, homography: Array, ground_image: Array, size_px: tuple[int, int]
    ) -> tuple[Image, Array]:
        """Return the texture (`_bordered`) at the resolution of a view, and the map (3, 3) to its samples.

        The view is a homography from the ground to the image, given with its inverse.
        """
        width, height = size_px
        center = ground_image @ [width / 2, height / 2, 1.0]
        scale = _local_scale(homography, center[:2] / center[2])
        wanted = SAMPLES_PER_PX * scale * float(np.sqrt(self.period_m.prod()))
        samples = COARSEST
        while 2 * samples <= min(wanted, FINEST):
            samples *= 2
        if samples not in self._levels and self._spectrum is not None:
            tile = _band_limited(self._spectrum, samples, self._sigma_px)
            self._levels[samples] = _bordered(tile)
        return self._levels[samples], np.diag([*(samples / self.period_m), 1.0])


@lru_cache(maxsize=2)
def _concrete_spectrum(seed: int, mean: float, contrast: float) -> npt.NDArray[np.complex128]:
    """Return the read-only spectrum (PERIOD, PERIOD // 2 + 1) of concrete.

    The last two are cached: computing one takes a fifth of a second, and repeated runs of a mission share it.
    """
    spectrum = concrete_spectrum(seed, mean, contrast)
    spectrum.flags.writeable = False
    return spectrum


def _bordered(tile: Image) -> Image:
    """Return a periodic texture (n, n) with each sample's lower neighbour: (n, n + APART, 2)."""
    wide = np.pad(tile, ((0, 1), (0, APART)), mode="wrap")
    return np.stack([wide[:-1], wide[1:]], axis=-1)


def _local_scale(homography: Array, at_m: Array) -> float:
    """Return the scale near a ground point, pixels per metre: root of the Jacobian's determinant."""
    w = homography[2] @ [*at_m, 1.0]
    return float(np.sqrt(abs(np.linalg.det(homography)) / abs(w) ** 3))


def _band_limited(spectrum: npt.NDArray[np.complex128], samples: int, sigma: float) -> Image:
    """Return a texture at a resolution of `samples` per period, blurred by sigma samples."""
    fy, fx = np.fft.fftfreq(PERIOD)[:, None] * PERIOD, np.fft.rfftfreq(PERIOD)[None, :] * PERIOD
    half = samples // 2
    rows = np.r_[0:half, PERIOD - half : PERIOD]
    radius = np.hypot(fy[rows], fx[:, : half + 1])
    kept = spectrum[rows, : half + 1] * np.exp(-2 * (np.pi * radius * sigma / samples) ** 2)
    image = np.fft.irfft2(kept, s=(samples, samples)) * (samples / PERIOD) ** 2
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
