"""Plan of a survey: markers and cameras from above the reference marker, with their uncertainties."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Polygon
from scipy.stats import chi2

from skyherd.drawing.palette import INK, MUTED, unit_color
from skyherd.geometry import ROBOT_FRAME_CORNERS, Array, to_points
from skyherd.plots.style import drawing_style, frame_square, legend_above, new_figure
from skyherd.survey.measure import CameraPose, MarkerPose, Survey
from skyherd.text import shorten

CONFIDENCE = 0.95
"""Probability that an ellipse contains the true place. Chosen."""

LARGEST_ELLIPSE = 0.08
"""Maximum half axis of an ellipse as a share of the plan's extent. Chosen: visible, and apart from others."""

MAX_LABELS = 60
"""Maximum number of markers with their numbers. Chosen: more would overlap."""

MAX_NAMED, MAX_NAME = 6, 60
"""Maximum number of cameras that the legend names, and of characters of a name. Chosen: a large plan."""

LABEL_ROOM = 0.03
"""Minimum distance of two cameras that both have a number, as a share of the extent. Chosen: two digits."""

SIDE_IN = 6.4
"""Side of the plan, inches."""


def draw_plan(found: Survey) -> Figure:
    """Draw the markers as squares with their heading, the cameras as circles with their line of sight.

    Markers that move between the pictures are hollow, at their last place with a line through all of them.
    Cameras are numbered as in the table of cameras. Ellipses contain the true place with 95 %. They are
    enlarged by a factor that the title states.
    """
    poses: list[MarkerPose | CameraPose] = [*found.markers, *found.cameras]
    places = np.array([one.position_m[:2] for one in poses])
    extent = max(float(np.ptp(places, axis=0).max()), 4 * found.side_m)
    spreads = [one.covariance[:2, :2] for one in poses]
    factor = _enlargement(spreads, extent)
    with drawing_style():
        figure = new_figure(SIDE_IN, width_in=SIDE_IN)
        axes = figure.subplots()
        last = {marker.id: marker for marker in found.markers}
        for marker in last.values():
            _draw_marker(axes, marker, found.side_m)
            path = np.array([one.position_m[:2] for one in found.markers if one.id == marker.id])
            axes.plot(*path.T, color=MUTED, lw=1)
            _draw_ellipse(axes, marker.position_m[:2], marker.covariance[:2, :2], factor, INK)
            if len(last) <= MAX_LABELS:
                _label(axes, str(marker.id), marker.position_m[:2], INK, centred=True)
        labelled: list[Array] = []
        for number, camera in enumerate(found.cameras):
            color, at = unit_color(number), camera.position_m[:2]
            sight = at + 0.08 * extent * camera.rotation[:2, 2]
            axes.plot(*zip(at, sight, strict=True), color=color, lw=1.5)
            axes.plot(*at, "o", color=color, ms=6)
            _draw_ellipse(axes, at, camera.covariance[:2, :2], factor, color)
            if all(np.linalg.norm(at - other) > LABEL_ROOM * extent for other in labelled):
                labelled.append(at)
                _label(axes, str(number + 1), at, color, centred=False)
        around = found.side_m * np.array([[-1.0, -1.0], [1.0, 1.0]])
        frame_square(axes, (places[:, None] + around).reshape(-1, 2))
        axes.set_xlabel(f"x of marker {found.reference} (m)")
        axes.set_ylabel(f"y of marker {found.reference} (m)")
        times = "" if factor == 1 else f", {factor:g} times enlarged"
        axes.set_title(f"ellipses: 95 % regions{times}", loc="left", fontsize=9, color=MUTED)
        legend_above(figure, _handles(found), columns=1 if len(found.cameras) > 1 else 2)
    return figure


def _draw_marker(axes: Axes, marker: MarkerPose, side_m: float) -> None:
    """Draw a square, hollow if the marker moves, with a line ahead."""
    face = MUTED if marker.view is None else "none"
    corners = side_m * to_points(ROBOT_FRAME_CORNERS) @ marker.rotation[:2, :2].T + marker.position_m[:2]
    axes.add_patch(Polygon(corners, facecolor=face, alpha=0.5, edgecolor=INK, lw=0.8))
    ahead = marker.position_m[:2] + 0.9 * side_m * marker.rotation[:2, 0]
    axes.plot(*zip(marker.position_m[:2], ahead, strict=True), color=MUTED, lw=1.2)


def _enlargement(spreads: list[Array], extent: float) -> float:
    """Return the factor, 1, 2 or 5 times a power of ten and at least 1, by which ellipses are enlarged."""
    largest_m = max(float(np.sqrt(chi2.ppf(CONFIDENCE, 2) * np.linalg.eigvalsh(s)[-1])) for s in spreads)
    if not largest_m > 0:
        return 1.0
    wanted = max(LARGEST_ELLIPSE * extent / largest_m, 1.0)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted))


def _draw_ellipse(axes: Axes, at: Array, covariance: Array, factor: float, color: str) -> None:
    values, vectors = np.linalg.eigh(covariance)
    half = factor * np.sqrt(chi2.ppf(CONFIDENCE, 2) * np.maximum(values, 0.0))
    angle_deg = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    axes.add_patch(
        Ellipse((at[0], at[1]), 2 * half[1], 2 * half[0], angle=angle_deg, fill=False, edgecolor=color, lw=1)
    )


def _label(axes: Axes, text: str, at: Array, color: str, *, centred: bool) -> None:
    axes.annotate(
        text.replace("$", r"\$"),
        (at[0], at[1]),
        xytext=(0, 0) if centred else (6, 6),
        textcoords="offset points",
        ha="center" if centred else "left",
        va="center" if centred else "bottom",
        color=color,
        fontsize=7 if centred else 8,
    )


def _handles(found: Survey) -> list[Line2D]:
    square: dict[str, Any] = {
        "color": MUTED,
        "markeredgecolor": INK,
        "marker": "s",
        "linestyle": "",
        "markersize": 6,
    }
    handles = [Line2D([], [], **square, label="marker")]
    if any(marker.view is not None for marker in found.markers):
        handles.append(Line2D([], [], **square | {"markerfacecolor": "none"}, label="marker that moves"))
    if len(found.cameras) > MAX_NAMED:
        label = f"cameras 1 to {len(found.cameras)} and their lines of sight, in the order of cameras.csv"
        return [*handles, Line2D([], [], color=unit_color(0), marker="o", label=label)]
    for number, camera in enumerate(found.cameras):
        name = shorten(camera.view.replace("$", r"\$"), MAX_NAME)
        label = f"camera {number + 1}: {name}, {camera.position_m[2]:.2f} m high"
        handles.append(Line2D([], [], color=unit_color(number), marker="o", label=label))
    return handles
