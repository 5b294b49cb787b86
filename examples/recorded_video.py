"""Detections and motion goals from a recorded video, frame by frame, as lines of text.

    python examples/recorded_video.py VIDEO.mp4 --shape star

The video looks down on robots with markers 0, 1, …; the shape is one of skyherd's named ones.
"""

import argparse
from collections.abc import Iterator

import av
import numpy as np

from skyherd.control import AerialController, Decision, Hover, SafetyRadius, Template
from skyherd.datasets import shape_points
from skyherd.vision import create_detector


def decisions(path: str, shape: str, robots: int) -> Iterator[tuple[int, Decision]]:
    """Yield the number of markers found and the unit's decision, for each frame of a video."""
    detector = create_detector("tracking", dictionary="4X4_50")
    template = Template.from_ground_points(np.arange(robots), shape_points(shape, robots))
    unit = AerialController(template, SafetyRadius(radius=1.2, dwell_s=1.0), Hover())
    with av.open(path) as video:
        for frame in video.decode(video=0):
            detections = detector.detect(frame.to_ndarray(format="gray"), time_s=float(frame.time or 0.0))
            yield len(detections), unit.step(detections)


def main() -> None:
    """Print what a unit would send."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("video")
    parser.add_argument("--shape", default="circle")
    parser.add_argument("--robots", type=int, default=12)
    options = parser.parse_args()
    for found, decision in decisions(options.video, options.shape, options.robots):
        goals = decision.goals
        text = (
            "too few robots for a shape"
            if goals is None
            else "  ".join(
                f"{robot}: {rho:.1f} px at {np.degrees(bearing):+.0f}°"
                for robot, rho, bearing in zip(goals.ids, goals.rho_px, goals.bearings_rad, strict=True)
            )
        )
        print(f"{decision.report.time_s:7.2f} s  {found} found  {text}")


if __name__ == "__main__":
    main()
