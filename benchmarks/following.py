"""Measure how often a following detector searches whole images while units climb and robots set off.

    python benchmarks/following.py                      # the first 20 s of three random missions
    python benchmarks/following.py --seeds 10008 --steps 300

The first 10 s of a random mission are the hardest for a following detector: units climb and stop, and then
all robots begin to turn at once. The table has the number of images, the number that both searches scanned,
and the detector's processor time an image, ms. Both searches always scan each unit's first image.
"""

import argparse
from collections import deque
from itertools import islice
from time import process_time
from typing import Any

from skyherd.datasets import make_mission, random_mission
from skyherd.loop import run_steps
from skyherd.messages import Detections
from skyherd.vision import PhotometricDetector

SEEDS, STEPS = [10002, 10008, 10013], 100
"""Missions, and how many steps of each. Chosen: of five to seven units, until robots have set off."""


def measure(seed: int, steps: int) -> dict[str, Any]:
    """Return a mission's images, thorough searches, and processor time of the detector, ms an image."""
    tree = random_mission(seed)
    tree["perception"] = "rendered"
    searches, times_s = 0, []
    search, detect = PhotometricDetector._search_with_fallback, PhotometricDetector.detect

    def counted(*given: Any) -> Any:
        nonlocal searches
        searches += 1
        return search(*given)

    def timed(self: PhotometricDetector, *given: Any, **how: Any) -> Detections:
        began_s = process_time()
        seen = detect(self, *given, **how)
        times_s.append(process_time() - began_s)
        return seen

    PhotometricDetector._search_with_fallback = counted  # type: ignore[method-assign]
    PhotometricDetector.detect = timed  # type: ignore[method-assign]
    try:
        deque(islice(run_steps(make_mission(tree)), steps), maxlen=0)
    finally:
        PhotometricDetector._search_with_fallback = search  # type: ignore[method-assign]
        PhotometricDetector.detect = detect  # type: ignore[method-assign]
    return {
        "seed": seed,
        "units": len(tree["units"]),
        "images": len(times_s),
        "searched": searches,
        "ms": 1e3 * sum(times_s) / len(times_s),
    }


def main() -> None:
    """Measure and print a line for each mission."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--steps", type=int, default=STEPS)
    options = parser.parse_args()
    print("| seed | units | images | searched by both looks | detector, ms an image |\n" + "| --- " * 5 + "|")
    for seed in options.seeds:
        row = measure(seed, options.steps)
        print(
            f"| {row['seed']} | {row['units']} | {row['images']} | {row['searched']} | {row['ms']:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
