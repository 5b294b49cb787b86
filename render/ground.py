"""The ground: a periodic concrete-like texture, band-limited at every scale it is seen at."""

import numpy as np
import numpy.typing as npt

from skyherd.geometry import Array, apply_homography
from skyherd.render.resample import warp


class Ground:
    """Endless textured ground, drawn by one warp per image.

    A tile of noise with a spectrum that falls as 1/f is kept at several resolutions, each low-passed by
    the image's own blur at that resolution, so that drawing it never aliases.

    Args:
        seed: of the texture.
        mean: grey level.
        contrast: standard deviation, grey levels.
        tile_m: period, metres.
        sigma_px: blur of lens and pixel, in image pixels.
    """

    def __init__(
        self,
        seed: int,
        *,
        mean: float = 128.0,
        contrast: float = 12.0,
        tile_m: float = 40.0,
        sigma_px: float = 0.85,
    ) -> None:
        self.mean, self.tile_m = mean, tile_m
        # Each tile is laid two by two: a view that starts in the first then rarely leaves them, and the
        # wrapping border of a warp costs six times its inside.
        self._levels = [
            (samples, np.tile(_concrete(seed, samples, mean, contrast, sigma_px), (2, 2)))
            for samples in (2048, 1024, 512, 256)
        ]

    def draw(self, homography: Array, size_px: tuple[int, int]) -> npt.NDArray[np.uint8]:
        """Ground seen through `homography` (ground metres to pixels), as an image (height, width)."""
        center = np.linalg.inv(homography) @ [size_px[0] / 2, size_px[1] / 2, 1.0]
        scale = _local_scale(homography, center[:2] / center[2])
        fits = [laid for period, laid in self._levels if period / self.tile_m <= 1.2 * scale]
        laid = fits[0] if fits else self._levels[-1][1]
        period = laid.shape[0] // 2
        sample_image = np.diag([period / self.tile_m, period / self.tile_m, 1.0]) @ np.linalg.inv(homography)
        width, height = size_px
        view = apply_homography(sample_image, [[0, 0], [width, 0], [width, height], [0, height]])
        near = np.eye(3)
        near[:2, 2] = -period * np.floor(view.min(axis=0) / period)
        sample_image = near @ sample_image
        return warp(laid, sample_image, size_px, wrap=True)


def _local_scale(homography: Array, at_m: Array) -> float:
    """Pixels a metre near one ground point: root of the Jacobian's determinant."""
    w = homography[2] @ [*at_m, 1.0]
    return float(np.sqrt(abs(np.linalg.det(homography)) / abs(w) ** 3))


def _concrete(seed: int, samples: int, mean: float, contrast: float, sigma: float) -> npt.NDArray[np.uint8]:
    """Periodic 1/f noise (samples, samples), one pattern at every resolution, blurred by sigma."""
    rng = np.random.default_rng(seed)
    fine = 2048
    spectrum = np.fft.rfft2(rng.standard_normal((fine, fine)))
    fy, fx = np.fft.fftfreq(fine)[:, None] * fine, np.fft.rfftfreq(fine)[None, :] * fine
    radius = np.hypot(fy, fx)
    spectrum *= radius > 6
    spectrum /= np.maximum(radius, 1.0) ** 1.0
    spectrum *= contrast / np.fft.irfft2(spectrum).std()
    spectrum *= np.exp(-2 * (np.pi * radius * sigma / samples) ** 2)
    half = samples // 2
    rows = np.r_[0:half, fine - half : fine]
    image = np.fft.irfft2(spectrum[rows, : half + 1], s=(samples, samples)) * (samples / fine) ** 2
    return np.clip(np.rint(image + mean), 0, 255).astype(np.uint8)
