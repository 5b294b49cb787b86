"""Compare `skyherd track` with a tracker made of OpenCV's detector, on recorded videos.

    python benchmarks/tracking_videos.py ../shared/robot-photographs/*.mp4 --dictionary 4X4_100

OpenCV's tracker is the usual one of overhead cameras: `cv2.aruco` with subpixel corners in each image, and a
marker that is missed stays at its last place for up to `HOLD` images. Columns, for each tracker:

- recall: markers per image that are detected, over those that any tracker detects in it or in both neighbours
  of it at the same place; held places do not count;
- held: the same with places that are held;
- jitter: standard deviation of a centre at rest, px, from second differences between images, as the median
  over markers that all trackers see in three images in a row;
- time: processor time an image, ms, median, without the decoding of the video, all trackers in alternation.
"""

import argparse
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
from command import run

from skyherd.files.video_reader import open_clip, read_clip
from skyherd.geometry import Array, Image
from skyherd.vision import Detector, create_detector

HOLD = 5
"""Images for which OpenCV's tracker keeps a missed marker. Chosen: a sixth of a second at 30 Hz."""

SAME_PLACE = 0.3
"""Distance of centres of one marker at most, in its sides."""

AT_REST = 0.02
"""Motion of a marker at rest between two images at most, in its sides. It is far above the jitter."""

Places = dict[int, Array]
"""Centre and side, px, (3,), of each marker of an image."""


class Skyherd:
    """Detector of `skyherd track`.

    Args:
        name: name of the detector.
        dictionary: the markers' dictionary.
    """

    def __init__(self, name: str, dictionary: str) -> None:
        self._detector: Detector = create_detector(name, dictionary=dictionary)

    def track(self, image: Image, time_s: float) -> tuple[Places, Places]:
        """Return the detected places, twice: none is held."""
        found = self._detector.detect(image, time_s=time_s).unambiguous()
        rows = np.column_stack([found.centers_px, found.sides_px])
        places = dict(zip(found.ids.tolist(), rows, strict=True))
        return places, places


class OpenCv:
    """Tracker of OpenCV's detector with subpixel corners, which holds missed markers for some images."""

    def __init__(self, dictionary: str) -> None:
        self._detector: Detector = create_detector("opencv-subpix", dictionary=dictionary)
        self._held: dict[int, tuple[int, Array]] = {}
        self._image = 0

    def track(self, image: Image, time_s: float) -> tuple[Places, Places]:
        """Return the detected places, and those with held ones."""
        found = self._detector.detect(image, time_s=time_s).unambiguous()
        rows = np.column_stack([found.centers_px, found.sides_px])
        places = dict(zip(found.ids.tolist(), rows, strict=True))
        self._image += 1
        self._held |= {marker: (self._image, place) for marker, place in places.items()}
        fresh = {marker: place for marker, (seen, place) in self._held.items() if self._image - seen <= HOLD}
        return places, fresh


def is_same(one: Array, other: Array) -> bool:
    """Return whether two places of one marker agree."""
    return bool(np.linalg.norm(one[:2] - other[:2]) < SAME_PLACE * max(one[2], other[2]))


def agreed_places(results: Sequence[Sequence[Places]]) -> list[Places]:
    """Return the places of an image that count as markers: those that are confirmed.

    A place is confirmed by another tracker in the same image, or by any tracker in a neighbouring image. One
    that is missed by all is added if the images before and after have it at the same place.

    Args:
        results: for each tracker, its detected places in each image.
    """
    count = len(results[0])
    agreed: list[Places] = []
    for k in range(count):
        near = [
            (t, j, results[t][j]) for t in range(len(results)) for j in (k - 1, k, k + 1) if 0 <= j < count
        ]
        places: Places = {}
        for t, j, found in near:
            for marker, place in found.items():
                witnesses = [
                    (other, i)
                    for other, i, more in near
                    if (other, i) != (t, j) and marker in more and is_same(place, more[marker])
                ]
                here = j == k and bool(witnesses)
                around = any({i, j} == {k - 1, k + 1} for _, i in witnesses)
                if here or around:
                    places.setdefault(marker, place)
        agreed.append(places)
    return agreed


def share(found: Sequence[Places], agreed: Sequence[Places]) -> float:
    """Return the share of the agreed places that a tracker has."""
    hits = sum(
        marker in mine and is_same(mine[marker], place)
        for mine, truth in zip(found, agreed, strict=True)
        for marker, place in truth.items()
    )
    return hits / max(1, sum(map(len, agreed)))


def jitters_px(results: Sequence[Sequence[Places]]) -> list[float]:
    """Return the jitter of each tracker, px, of markers at rest that all trackers see; NaN without any.

    A second difference of centres has six times the variance of a centre. It excludes a steady motion.
    """
    squares: list[dict[int, list[float]]] = [{} for _ in results]
    for k in range(1, len(results[0]) - 1):
        triples = [found[k - 1 : k + 2] for found in results]
        shared = set.intersection(*(set(places) for triple in triples for places in triple))
        for marker in shared:
            rows = np.array([[places[marker] for places in triple] for triple in triples])
            steps_px = np.linalg.norm(np.diff(rows[..., :2], axis=1), axis=2)
            if (steps_px < AT_REST * rows[:, 1:, 2]).all():
                bends = rows[:, 0, :2] - 2 * rows[:, 1, :2] + rows[:, 2, :2]
                for tracker, bend in zip(squares, bends, strict=True):
                    tracker.setdefault(marker, []).append(float(np.mean(bend**2)) / 6)
    return [
        float(np.median([np.sqrt(np.mean(values)) for values in tracker.values()])) if tracker else np.nan
        for tracker in squares
    ]


def measure(path: Path, dictionary: str, skip: int, frames: int) -> list[str]:
    """Return the rows of the table of one video."""
    cv2.setNumThreads(1)
    trackers = {
        "`track --detector tracking`": Skyherd("tracking", dictionary),
        "`track`": Skyherd("photometric", dictionary),
        "OpenCV": OpenCv(dictionary),
    }
    found: list[list[Places]] = [[] for _ in trackers]
    held: list[list[Places]] = [[] for _ in trackers]
    times_s: list[list[float]] = [[] for _ in trackers]
    for frame in islice(read_clip(open_clip(path)), skip, skip + frames):
        for number, tracker in enumerate(trackers.values()):
            begun_s = time.process_time()
            seen, kept = tracker.track(frame.image, frame.time_s)
            times_s[number].append(time.process_time() - begun_s)
            found[number].append(seen)
            held[number].append(kept)
    agreed, jitter = agreed_places(found), jitters_px(found)
    return [
        f"| {path.stem} | {name} | {len(agreed)} | {sum(map(len, agreed))} | {share(found[k], agreed):.1%} "
        f"| {share(held[k], agreed):.1%} | {f'{jitter[k]:.2f}' if np.isfinite(jitter[k]) else '–'} "
        f"| {1000 * np.median(times_s[k]):.0f} |"
        for k, name in enumerate(trackers)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("videos", nargs="+", type=Path)
    parser.add_argument("--dictionary", default="4X4_50")
    parser.add_argument("--frames", type=int, default=200, help="of each video at most")
    parser.add_argument("--skip", type=int, default=0, help="images at the start that are left out")
    given = parser.parse_args()
    print("| video | tracker | images | markers | recall | held | jitter, px | ms an image |")
    print("|---" * 8 + "|")
    for path in given.videos:
        print("\n".join(measure(path, given.dictionary, given.skip, given.frames)), flush=True)


if __name__ == "__main__":
    run(main)
