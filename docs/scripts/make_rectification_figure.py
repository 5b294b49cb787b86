"""Make rectification.png: one camera's image, the same rectified, and the remaining shape error.

python docs/scripts/make_rectification_figure.py            # writes docs/rectification.png
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes

from skyherd.control import GroundMap
from skyherd.datasets import Mission, make_mission, parse_toml, scenario_text
from skyherd.drawing.palette import INK, TEMPLATE_COLOR, UNIT_COLORS
from skyherd.geometry import Array
from skyherd.loop import Step, run_steps
from skyherd.plots.style import drawing_style, new_figure

FIGURE = Path(__file__).parent.parent / "rectification.png"
CAMERA = {
    "size_px": [800, 800],
    "half_angle_deg": 25.0,
    "aspect": 1.15,
    "skew": 0.04,
    "distortion": {"k1": -0.3},
}
UNIT = {
    "position_m": [1.1, 4.2],
    "height_m": 20.0,
    "yaw_deg": 20.0,
    "tilt_deg": [10.0, 7.0],
    "camera": CAMERA,
    "flight": {"kind": "hover"},
}
GRID_M = np.arange(-6.0, 6.1, 1.5)


def fly(*, rectify: bool) -> tuple[Mission, list[Step]]:
    """Return the mission: a star of sixteen under one hovering uncalibrated camera."""
    tree: dict[str, Any] = parse_toml(scenario_text("star"), "star", "")
    tree |= {"duration_s": 12.0, "units": [UNIT], "seed": 4}
    tree["robots"] = {"scatter": {"scale_m": 0.72, "jitter_m": 0.6, "spacing_m": 1.1}}
    tree["marker"] = {"side_m": 0.72}
    tree["selection"] = {"radius": 1.5}
    tree["control"] |= {"k": 0.8, "k_omega": 3.2, "b_th": 0.0, "rectify": rectify}
    mission = make_mission(tree)
    return mission, list(run_steps(mission))


def rectified_image(image: Array, ground_map: GroundMap) -> Array:
    """Return the image of an ideal camera, sampled through the inverse map."""
    height, width = image.shape
    v, u = np.mgrid[:height, :width].astype(float)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    there = (
        ground_map.image_px(pixels, np.array([width, height])).astype(np.float32).reshape(height, width, 2)
    )
    return cv2.remap(image, there[..., 0], there[..., 1], cv2.INTER_AREA, borderValue=255)


def show(axes: Axes, image: Array, points_px: Array, fitted_px: Array, title: str) -> None:
    """Return an image with circles at the template's points under the best similarity."""
    axes.imshow(image, cmap="gray", vmin=0, vmax=255)
    axes.plot(*fitted_px.T, "o", ms=12, mfc="none", mec=TEMPLATE_COLOR, mew=1.6)
    axes.set_title(title, fontsize=10, color=INK)
    axes.set_xlabel("circles: the template's best fit", fontsize=8)
    axes.set(xticks=[], yticks=[], xlim=(-0.5, image.shape[1] - 0.5), ylim=(image.shape[0] - 0.5, -0.5))


def fitted(mission: Mission, points_px: Array) -> Array:
    """Return the template's points (N, 2) mapped to the image by the best similarity."""
    template = mission.template.points_of(mission.ids)
    seen = points_px @ np.array([1, 1j])
    centred = template - template.mean()
    points = np.vdot(centred, seen - seen.mean()) / np.vdot(centred, centred) * centred + seen.mean()
    return np.column_stack([points.real, points.imag])


def main() -> None:
    """Run the flight, draw the figure and save it."""
    runs = {rectify: fly(rectify=rectify) for rectify in (False, True)}
    mission, steps = runs[True]
    frame = steps[-1].frames[0]
    image, seen = frame.sight.image, frame.sight.detections
    assert image is not None
    size = np.array([image.shape[1], image.shape[0]])
    ideal_px = frame.decision.ground_map.rectified_px(seen.centers_px, size)
    with drawing_style():
        figure = new_figure(2.9)
        raw, straight, errors = figure.subplots(1, 3, width_ratios=[1.15, 1.15, 1])
        show(raw, image, seen.centers_px, fitted(mission, seen.centers_px), "the camera's image")
        show(
            straight,
            rectified_image(image, frame.decision.ground_map),
            ideal_px,
            fitted(mission, ideal_px),
            "rectified",
        )
        for rectify, (_, flown) in runs.items():
            curve = [step.metrics.shape.error for step in flown]
            errors.semilogy(
                [step.time_s for step in flown],
                curve,
                color=UNIT_COLORS[0] if rectify else UNIT_COLORS[1],
                lw=1.8,
            )
            middle = len(curve) // 2
            errors.annotate(
                "self-rectified" if rectify else "as seen",
                (flown[middle].time_s, curve[middle]),
                (7, 5),
                textcoords="offset points",
                fontsize=9,
            )
        errors.set(xlabel="time (s)", ylabel="RMS distance / RMS radius", ylim=(2e-5, 0.3))
        errors.set_title("shape error on the ground", fontsize=10, color=INK)
        figure.savefig(FIGURE, dpi=130)


if __name__ == "__main__":
    main()
