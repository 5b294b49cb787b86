"""Compare following with single images on videos: markers found in all frames.

    python benchmarks/followed_videos.py ../shared/robot-photographs/*.mp4 --dictionary 4X4_100

Columns: frames; markers found in all frames by `photometric` with following (`tracking`), by `photometric` on
single images, and by OpenCV's detector; those of single images that following misses, and the reverse.
"""

import argparse
from itertools import islice
from pathlib import Path

import numpy as np
from command import run

from skyherd.files.video_reader import open_clip, read_clip
from skyherd.messages import Detections
from skyherd.vision import create_detector

NAMES = ("tracking", "photometric", "opencv")
SAME_PLACE = 0.3
"""Distance of centres of one marker at most, in its sides."""


def missed(one: Detections, other: Detections) -> int:
    """Return how many markers of one are not among the other."""
    count = 0
    for marker, center, side in zip(one.ids, one.centers_px, one.sides_px, strict=True):
        there = other.centers_px[other.ids == marker]
        count += not (np.linalg.norm(there - center, axis=1) < SAME_PLACE * side).any()
    return count


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("videos", nargs="+", type=Path)
    parser.add_argument("--dictionary", default="4X4_50")
    parser.add_argument("--inverted", action="store_true")
    parser.add_argument("--frames", type=int, default=200, help="of each video at most")
    parser.add_argument("--every", type=int, default=1, help="take one of so many frames")
    given = parser.parse_args()
    print("| video | frames | " + " | ".join(NAMES) + " | missed by following | by single images |")
    print("|---" * (4 + len(NAMES)) + "|")
    for path in given.videos:
        detectors = [create_detector(name, dictionary=given.dictionary) for name in NAMES]
        found, lost, gained, number = [0] * len(NAMES), 0, 0, 0
        for frame in islice(read_clip(open_clip(path)), 0, given.frames * given.every, given.every):
            image = 255 - frame.image if given.inverted else frame.image
            seen = [detector.detect(image, time_s=frame.time_s) for detector in detectors]
            found = [total + len(one) for total, one in zip(found, seen, strict=True)]
            lost, gained = lost + missed(seen[1], seen[0]), gained + missed(seen[0], seen[1])
            number += 1
        print(
            f"| {path.name} | {number} | " + " | ".join(map(str, [*found, lost, gained])) + " |", flush=True
        )


if __name__ == "__main__":
    run(main)
