"""Sightings of a detector in one image, including repeated ids, and detectors for a set's markers."""

from dataclasses import dataclass, replace
from inspect import signature
from time import perf_counter
from typing import Any

import numpy as np
import numpy.typing as npt

from skyherd.bench.entrants import EntrantError
from skyherd.errors import InputError, SkyherdError
from skyherd.geometry import Array, IntArray
from skyherd.messages import Quality
from skyherd.vision import REPORT_REPEATS, Detector, create_detector


@dataclass(frozen=True)
class Sightings:
    """Result of a detector in one image.

    Attributes:
        ids: (K,) ids of the markers, which may repeat.
        corners_px: (K, 4, 2) corners, in the order of `skyherd.geometry.SQUARE_CORNERS`.
        covariances: (K, 3, 3) of (u, v, heading); all zero where the detector reports none.
        qualities: (K,) numbers of `Quality`.
        time_ms: processing time.
    """

    ids: IntArray
    corners_px: Array
    covariances: Array
    qualities: IntArray
    time_ms: float = 0.0


class Reader:
    """A detector for the images of one set, without memory between images.

    Args:
        name: name of the detector, or `module:factory`.
        dictionary: dictionary of the markers.
        options: additional marker options of `create_detector`, such as `border_bits`.

    Raises:
        InputError: the detector cannot read such markers.
    """

    def __init__(self, name: str, dictionary: str, options: dict[str, Any]) -> None:
        if unknown := options.keys() - signature(create_detector).parameters.keys():
            raise InputError(
                f"detector {name}", f"does not support {', '.join(sorted(unknown))}", "usual markers"
            )
        self.name = name
        if name in REPORT_REPEATS:
            options = options | {"repeats": True}
        self._detector: Detector = create_detector(name, dictionary=dictionary, **options)
        self._images = 0

    def read(self, image: npt.NDArray[np.uint8]) -> Sightings:
        """Find the markers in a grey image, all places of an id if the detector reports them.

        Each image has its own `unit_id`, so that nothing learned from another affects it.

        Raises:
            EntrantError: the detector raised an exception.
        """
        self._images += 1
        start = perf_counter()
        try:
            found = self._find(image)
        except SkyherdError as error:
            raise EntrantError(f"detector {self.name}: {error}") from None
        except Exception as error:
            raise EntrantError(f"detector {self.name}: {type(error).__name__}: {error}") from error
        return replace(found, time_ms=1e3 * (perf_counter() - start))

    def _find(self, image: npt.NDArray[np.uint8]) -> Sightings:
        find_all: Any = getattr(self._detector, "find_all", None)
        if find_all is not None:
            ids, corners = find_all(image)
            return Sightings(ids, corners, np.zeros((len(ids), 3, 3)), np.full(len(ids), Quality.CORNERS))
        found = self._detector.detect(image, unit_id=self._images)
        return Sightings(found.ids, found.corners_px, found.covariances, found.qualities)


def make_readers(
    names: list[str], dictionary: str, options: dict[str, Any]
) -> tuple[dict[str, Reader], dict[str, str]]:
    """Make a reader of each detector for markers of one kind.

    Returns:
        the readers by name, and the reasons why the others have none.
    """
    readers: dict[str, Reader] = {}
    refused: dict[str, str] = {}
    for name in names:
        try:
            readers[name] = Reader(name, dictionary, options)
        except InputError as error:
            refused[name] = error.what
    return readers, refused
