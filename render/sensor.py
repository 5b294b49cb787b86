"""Sensor model: from light to grey levels of 8 bits.

For light L (grey levels) at a pixel at p from the image centre, in halves of the image's shorter side,

    s = gain · L · (1 - vignetting |p|² / |p_corner|²)
                 · (1 + gradient / 2 · p·n / max p·n)
                 · (1 - shadow Φ((p·m - shadow_offset) / shadow_edge))
    y = s + sqrt(noise² + shot s) ε,      rounded and clipped to 0-255,

with ε standard normal and white, Φ the normal distribution function, and n, m the directions of gradient and
shadow. With colour filters (`skyherd.render.processing`) white balance scales the noise. Image processing
applies to y before the rounding. JPEG and video compression follow it.
"""

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from skyherd.errors import InputError
from skyherd.geometry import Array, Image
from skyherd.render.processing.development import UNPROCESSED, Processing

if TYPE_CHECKING:
    from skyherd.render.processing.video_stream import VideoStream


Light = npt.NDArray[np.float32]
"""Light in grey levels, or a factor on light, (height, width)."""

BANK_EXTRA_PX = 256
"""Excess of width and height of a bank of normal deviates over the image. *Chosen*: it has 65 536 offsets, so
that noise rarely repeats; more cost memory."""

SHARPEST_EDGE = 1e-6
"""Smallest softness of a shadow's edge, halves of the image's shorter side. *Chosen*: avoids a division by
zero; far below a pixel."""


@dataclass(frozen=True)
class Illumination:
    """Spatial variation of light over the image: vignetting, gradient and shadow; each is off at 0.

    Attributes:
        vignetting: relative loss of light at the image corners.
        gradient: relative change of light from one border to the other, symmetric about 1.
        gradient_rad: direction of increasing light, from +u to +v.
        shadow: relative loss of light in a cast shadow.
        shadow_offset: distance of the shadow's edge from the centre, halves of the image's shorter side.
        shadow_rad: direction from the edge into the shadow, from +u to +v.
        shadow_edge: standard deviation of the edge's softness, halves of the image's shorter side.
    """

    vignetting: float = 0.0
    gradient: float = 0.0
    gradient_rad: float = 0.0
    shadow: float = 0.0
    shadow_offset: float = 0.0
    shadow_rad: float = 0.0
    shadow_edge: float = 0.05

    @property
    def even(self) -> bool:
        """True if the factor is 1 everywhere."""
        return not (self.vignetting or self.gradient or self.shadow)

    def of(self, size_px: tuple[int, int]) -> Light:
        """Return the factor (height, width) on light, for an image of `size_px` (width, height)."""
        half = min(size_px) / 2
        u: Array
        v: Array
        u, v = (np.asarray((np.arange(n) - (n - 1) / 2) / half) for n in size_px)
        far = np.array(size_px) / 2 / half
        factor = 1 - self.vignetting * (u[None, :] ** 2 + v[:, None] ** 2) / (far**2).sum()
        if self.gradient:
            along = _along(u, v, self.gradient_rad)
            reach = np.abs([np.cos(self.gradient_rad), np.sin(self.gradient_rad)]) @ far
            factor *= 1 + self.gradient / 2 * along / reach
        if self.shadow:
            into = _along(u, v, self.shadow_rad) - self.shadow_offset
            factor *= 1 - self.shadow * ndtr(into / max(self.shadow_edge, SHARPEST_EDGE))
        return np.asarray(factor, dtype=np.float32)


def _along(u: Array, v: Array, angle_rad: float) -> Array:
    """Return the coordinate (height, width) along a direction."""
    return np.asarray(u[None, :] * np.cos(angle_rad) + v[:, None] * np.sin(angle_rad))


class Sensor:
    """Sensor that converts light to an image of 8 bits by the model of the module's docstring.

    Drawing normal deviates takes longer than all the rest of a frame. They are therefore drawn once, and read
    at a random offset in each frame.

    Args:
        noise: standard deviation of the noise independent of light, grey levels.
        rng: random generator of the noise.
        shot: ratio of the shot noise's variance to the signal, grey levels: 255 over the full-well capacity
            in electrons; 0 for none.
        gain: factor on the light.
        illumination: spatial variation of the light; uniform if None.
        jpeg_quality: quality of JPEG compression, 1 to 100; None for none.
        processing: image processing of the camera.

    Raises:
        InputError: `jpeg_quality` is out of range.
    """

    def __init__(
        self,
        noise: float,
        rng: np.random.Generator,
        *,
        shot: float = 0.0,
        gain: float = 1.0,
        illumination: Illumination | None = None,
        jpeg_quality: int | None = None,
        processing: Processing = UNPROCESSED,
    ) -> None:
        if jpeg_quality is not None and not 1 <= jpeg_quality <= 100:
            raise InputError("jpeg_quality", str(jpeg_quality), "from 1 to 100, or none")
        self.noise, self.shot, self.gain, self.jpeg_quality = noise, shot, gain, jpeg_quality
        self.illumination = illumination or Illumination()
        self.processing = processing
        self._rng = rng
        self._banks: dict[tuple[int, int], tuple[Image, Image]] = {}
        self._deviates: dict[tuple[int, int], Light] = {}
        self._factors: dict[tuple[int, int], Light] = {}
        self._videos: dict[tuple[int, int, int], VideoStream] = {}

    def varied(self, noise: float, gain: float) -> "Sensor":
        """Return a sensor with another noise and gain, which shares all else, also the random numbers."""
        sensor = copy(self)
        sensor.noise, sensor.gain, sensor._banks = noise, gain, {}
        return sensor

    @property
    def linear(self) -> bool:
        """True if only noise changes the light, so that `expose` can process 8-bit images directly."""
        untouched = not self.shot and self.gain == 1 and self.illumination.even
        return untouched and not self.processing.develops

    @property
    def is_video(self) -> bool:
        """True with video compression, whose images depend on earlier ones."""
        return self.processing.h264_crf is not None

    def expose(self, light: Image | Light, stream: int = 0) -> Image:
        """Return the image (height, width) of light (height, width), with new noise.

        Args:
            light: light in grey levels; the array may be overwritten.
            stream: number of the camera's video stream, where one sensor serves several cameras.
        """
        if light.dtype == np.uint8 and self.linear:
            image = self._add_noise(np.asarray(light, dtype=np.uint8))
        else:
            image = self._convert(np.asarray(light, dtype=np.float32))
        if self.jpeg_quality is not None:
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality])
            image = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
        if self.processing.h264_crf is None:
            return image
        return self._video(stream, image.shape, self.processing.h264_crf).send(image)

    def skip(self, size_px: tuple[int, int]) -> None:
        """Draw the random numbers of `expose` for an image of `size_px` (width, height), without an image.

        Several sensors with equal generators can share a sequence of images: each exposes some and skips the
        others. The images equal those of a single sensor.
        """
        width, height = size_px
        if self.noise > 0 or self.shot:
            self._window(self._deviates_of(height, width), height, width)

    def _video(self, stream: int, shape: tuple[int, ...], crf: int) -> "VideoStream":
        """Return the video stream of a camera."""
        # Imported here, since PyAV takes long to load.
        from skyherd.render.processing.video_stream import VideoStream

        key = (stream, shape[0], shape[1])
        if key not in self._videos:
            self._videos[key] = VideoStream((shape[1], shape[0]), crf)
        return self._videos[key]

    def _convert(self, light: Light) -> Image:
        """Apply the whole model, in floating point."""
        height, width = light.shape
        if not self.illumination.even:
            if (height, width) not in self._factors:
                self._factors[height, width] = self.illumination.of((width, height))
            light *= self._factors[height, width]
        if self.gain != 1:
            light *= np.float32(self.gain)
        if self.noise or self.shot:
            deviates = self._window(self._deviates_of(height, width), height, width)
            if self.processing.mosaic.on:
                gains = self.processing.mosaic.gains(height, width)
                variance = np.maximum(light, 0.0) * np.float32(self.shot) * gains
                variance += np.float32(self.noise**2) * gains * gains
                light += np.sqrt(variance, out=variance) * deviates
            elif self.shot:
                variance = np.maximum(light, 0.0) * np.float32(self.shot)
                variance += np.float32(self.noise**2)
                light += np.sqrt(variance, out=variance) * deviates
            else:
                light += np.float32(self.noise) * deviates
        if self.processing.develops:
            return self.processing.develop(light)
        np.rint(light, out=light)
        return np.clip(light, 0, 255, out=light).astype(np.uint8)

    def _add_noise(self, image: Image) -> Image:
        """Add rounded noise of `noise` grey levels, with saturation, in place."""
        if self.noise <= 0:
            return image
        height, width = image.shape
        if (height, width) not in self._banks:
            drawn = np.rint(self.noise * self._deviates_of(height, width))
            more, less = (np.clip(part, 0, 255).astype(np.uint8) for part in (drawn, -drawn))
            self._banks[height, width] = more, less
        y, x = self._rng.integers(0, BANK_EXTRA_PX, size=2)
        more, less = self._banks[height, width]
        cv2.add(image, more[y : y + height, x : x + width], dst=image)
        cv2.subtract(image, less[y : y + height, x : x + width], dst=image)
        return image

    def _deviates_of(self, height: int, width: int) -> Light:
        """Return the bank of normal deviates for an image size."""
        if (height, width) not in self._deviates:
            shape = (height + BANK_EXTRA_PX, width + BANK_EXTRA_PX)
            self._deviates[height, width] = self._rng.standard_normal(shape, dtype=np.float32)
        return self._deviates[height, width]

    def _window(self, bank: Light, height: int, width: int) -> Light:
        y, x = self._rng.integers(0, BANK_EXTRA_PX, size=2)
        return bank[y : y + height, x : x + width]
