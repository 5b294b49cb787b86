"""The sensor: read noise from a bank, added with saturation."""

import cv2
import numpy as np
import numpy.typing as npt

BANK_EXTRA_PX = 256


class Sensor:
    """Adds white Gaussian noise of standard deviation `noise` grey levels to 8-bit images.

    Fresh normal deviates cost more than all the rest of a frame, so that a bank is drawn once and read
    at a random offset each time.
    """

    def __init__(self, noise: float, rng: np.random.Generator) -> None:
        self.noise = noise
        self._rng = rng
        self._banks: dict[tuple[int, int], tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]] = {}

    def expose(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Add noise to `image` in place and return it."""
        if self.noise <= 0:
            return image
        height, width = image.shape
        plus, minus = self._bank(height, width)
        y, x = self._rng.integers(0, BANK_EXTRA_PX, size=2)
        cv2.add(image, plus[y : y + height, x : x + width], dst=image)
        cv2.subtract(image, minus[y : y + height, x : x + width], dst=image)
        return image

    def _bank(self, height: int, width: int) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        if (height, width) not in self._banks:
            shape = (height + BANK_EXTRA_PX, width + BANK_EXTRA_PX)
            noise = np.rint(self.noise * self._rng.standard_normal(shape, dtype=np.float32))
            self._banks[height, width] = (
                np.clip(noise, 0, 255).astype(np.uint8),
                np.clip(-noise, 0, 255).astype(np.uint8),
            )
        return self._banks[height, width]
