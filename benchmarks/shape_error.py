"""Measure the share of a detector's error that reaches the formation: `star`, flown with each detector.

    python benchmarks/shape_error.py             # Markdown table on stdout, figure to docs/shape_error.png
    python benchmarks/shape_error.py --detectors tracking opencv --figure other.png

Robots and cameras start at the end of a flight on exact projections, and the robots never stop (`b_th = 0`).
The residual shape error then comes from the detector alone. Its mean over the last `--average` seconds of
simulated time, after `--settle` seconds, is plotted over the detector's position RMSE in the same images. The
RMSE is per axis, in marker sides, bias included.

Two lines serve for comparison: the same flight on exact projections with added Gaussian errors, drawn again
in each image, or once for each marker and camera. The loop averages the former, and not the latter.
"""

import argparse
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes

from skyherd.bench.entrants import default_entrants, dictionary_for, is_ours
from skyherd.datasets import Mission, load_mission, make_mission
from skyherd.drawing.palette import INK, PAPER, UNIT_COLORS
from skyherd.loop import run_steps
from skyherd.messages import Detections
from skyherd.plots.style import drawing_style, new_figure
from skyherd.sim.perception import RenderedPerception
from skyherd.sim.projected_perception import ProjectedPerception
from skyherd.sim.sight import Perception, Sight
from skyherd.sim.world import World

FIGURE = Path(__file__).parent.parent / "docs" / "shape_error.png"
SCENARIO = "star"
IDEAL_S = 120.0
"""Settling time on exact projections, s. Derived: leaves a shape error of 2e-6, ten times less every 30 s."""

SIGMAS = (1e-4, 1e-3, 1e-2, 5e-2)
"""Standard deviations of errors added to exact projections, marker sides."""

LINE = 0.13
"""Height of a name in the figure, decades of shape error."""


@dataclass(frozen=True)
class Flight:
    """Outcome of one flight.

    Attributes:
        name: of the detector.
        rmse_sides: of the positions found, per axis; NaN if nothing was found.
        shape_error: mean over the time averaged; `worst` its maximum.
        recall: share of the whole markers in view that were found.
        rmse_px: the same as `rmse_sides`, px.
        side_px: mean true side of the markers found.
        reached: whether the shape error stayed under the scenario's goal.
    """

    name: str
    rmse_sides: float
    shape_error: float
    worst: float
    recall: float
    rmse_px: float
    side_px: float
    reached: bool


class Watched:
    """A perception whose detections are compared with ground truth from `start_s` on."""

    def __init__(self, inner: Perception, dictionary: str, side_m: float, start_s: float) -> None:
        self.inner, self.start_s = inner, start_s
        self._exact = ProjectedPerception(side_m, dictionary)
        self.errors_px: list[np.ndarray] = []
        self.sides_px: list[np.ndarray] = []
        self.whole = self.found = 0

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """Return the other perception's detections, and record their errors."""
        sights = self.inner.look(world, units, time_s)
        if time_s > self.start_s:
            for sight, exact in zip(sights, self._exact.look(world, units, time_s), strict=True):
                self._keep_errors(sight, exact.detections)
        return sights

    def _keep_errors(self, sight: Sight, truth: Detections) -> None:
        ids, seen = np.intersect1d(sight.found_ids, truth.ids), sight.detections
        mine, its = (np.array([np.flatnonzero(d.ids == i)[0] for i in ids], int) for d in (seen, truth))
        self.errors_px.append(seen.centers_px[mine] - truth.centers_px[its])
        self.sides_px.append(truth.sides_px[its])
        self.whole, self.found = self.whole + sight.whole_ids.size, self.found + sight.found_ids.size


class Erring:
    """Exact projections with Gaussian errors of `sigma` marker sides, redrawn in each image or `fixed`."""

    def __init__(
        self, exact: ProjectedPerception, sigma: float, rng: np.random.Generator, *, fixed: bool
    ) -> None:
        self.exact, self.sigma, self.rng = exact, sigma, rng
        self.fixed: dict[tuple[int, int], np.ndarray] | None = {} if fixed else None

    def look(self, world: World, units: Sequence[int], time_s: float) -> list[Sight]:
        """Return exact projections with added errors."""
        sights = self.exact.look(world, units, time_s)
        return [self._err(sight, unit) for unit, sight in zip(units, sights, strict=True)]

    def _err(self, sight: Sight, unit: int) -> Sight:
        seen = sight.detections
        draws = self.rng.standard_normal((len(seen), 2))
        if self.fixed is not None:
            draws = np.array(
                [
                    self.fixed.setdefault((unit, i), draw)
                    for i, draw in zip(seen.ids.tolist(), draws, strict=True)
                ]
            ).reshape(-1, 2)
        shift = self.sigma * seen.sides_px[:, None] * draws
        moved = replace(
            seen, centers_px=seen.centers_px + shift, corners_px=seen.corners_px + shift[:, None, :]
        )
        return replace(sight, detections=moved)


def settled_tree() -> dict[str, Any]:
    """Return the scenario with robots and cameras at the end of a flight on exact projections."""
    mission = load_mission(SCENARIO, ["control.b_th=0", "perception=ideal", f"duration_s={IDEAL_S}"])
    last = deque(run_steps(mission), maxlen=1).pop()
    tree = mission.scenario.model_dump(mode="json", exclude_none=True)
    tree["robots"]["positions_m"] = last.positions_m.tolist()
    tree["robots"]["headings_deg"] = np.degrees(last.headings_rad).tolist()
    fleet = last.fleet
    for unit, model in enumerate(tree["units"]):
        model["position_m"] = fleet.positions_m[unit].tolist()
        model["height_m"] = float(fleet.heights_m[unit])
        model["yaw_deg"] = float(np.degrees(fleet.yaws_rad[unit]))
    return tree | {"perception": "rendered"}


def fly(mission: Mission, perception: Perception, name: str, settle_s: float) -> Flight:
    """Fly a mission with a perception, and average from `settle_s` to its end."""
    marker = mission.scenario.marker
    watched = Watched(perception, marker.dictionary, marker.side_m, settle_s)
    errors = np.array(
        [step.metrics.shape.error for step in run_steps(mission, watched) if step.time_s > settle_s]
    )
    position, sides = np.concatenate(watched.errors_px), np.concatenate(watched.sides_px)
    return Flight(
        name=name,
        rmse_sides=_rms(position / sides[:, None]),
        shape_error=float(errors.mean()),
        worst=float(errors.max()),
        recall=watched.found / watched.whole if watched.whole else 0.0,
        rmse_px=_rms(position),
        side_px=float(sides.mean()) if sides.size else float("nan"),
        reached=bool((errors < mission.scenario.goal.shape_error).all()),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def fly_detector(name: str, tree: dict[str, Any], settle_s: float) -> Flight:
    """Fly on rendered images with a detector."""
    cv2.setNumThreads(1)
    dictionary = dictionary_for(name, tree["marker"]["dictionary"])
    mission = make_mission(
        tree | {"detector": name, "marker": tree["marker"] | {"dictionary": dictionary}}, where=SCENARIO
    )
    return fly(
        mission, RenderedPerception(mission, np.random.default_rng(mission.scenario.seed)), name, settle_s
    )


def fly_erring(sigma: float, tree: dict[str, Any], settle_s: float, *, fixed: bool) -> Flight:
    """Fly on exact projections with added errors."""
    mission = make_mission(tree, where=SCENARIO)
    marker = mission.scenario.marker
    exact = ProjectedPerception(marker.side_m, marker.dictionary)
    erring = Erring(exact, sigma, np.random.default_rng(mission.scenario.seed), fixed=fixed)
    return fly(mission, erring, "fixed errors" if fixed else "errors new in each image", settle_s)


def print_table(flights: list[Flight]) -> None:
    print("| detector | recall | marker side px | position RMSE px | sides | shape error, mean | worst |")
    print("|---|---|---|---|---|---|---|")
    for flight in sorted(flights, key=lambda flight: flight.rmse_sides):
        print(
            f"| {flight.name} | {flight.recall:.4f} | {flight.side_px:.1f} | {flight.rmse_px:.4f} | "
            f"{flight.rmse_sides:.2e} | {flight.shape_error:.2e} | {flight.worst:.2e}"
            f"{'' if flight.reached else ' (goal missed)'} |",
            flush=True,
        )


def draw(flights: list[Flight], lines: list[list[Flight]], path: Path) -> None:
    """Draw shape error over position RMSE, a point a detector; open points missed the scenario's goal."""
    x, y = np.array([(flight.rmse_sides, flight.shape_error) for flight in flights]).T
    with drawing_style():
        figure = new_figure(4.8)
        axes = figure.subplots()
        axes.set(
            xscale="log", yscale="log", xlim=(x.min() / 3, x.max() * 4), ylim=(y.min() / 2, y.max() * 10)
        )
        axes.set_xlabel("position RMSE per axis (marker sides)")
        axes.set_ylabel("shape error (RMS distance / RMS radius)")
        for points, style in zip(lines, ("-", "--"), strict=True):
            _draw_line(axes, points, style, above=style == "--")
        for flight in flights:
            color = UNIT_COLORS[0] if is_ours(flight.name) else UNIT_COLORS[1]
            face = color if flight.reached else "white"
            axes.plot(flight.rmse_sides, flight.shape_error, "o", ms=7, mec=color, mfc=face)
        _name(axes, flights)
        figure.savefig(path, dpi=110)


def _draw_line(axes: Axes, points: list[Flight], style: str, *, above: bool) -> None:
    """Draw the proportionality of some flights, with its name on the side without points."""
    factor = float(np.exp(np.mean([np.log(point.shape_error / point.rmse_sides) for point in points])))
    ends, (low, high) = np.array(axes.get_xlim()), axes.get_ylim()
    axes.plot(ends, factor * ends, color=INK, ls=style, lw=1.1, zorder=1)
    y = low * (high / low) ** (0.8 if above else 0.3)
    axes.annotate(
        f"{points[0].name}:\n{factor:.2g} x RMSE",
        (y / factor, y),
        (-26 if above else 26, 0),
        textcoords="offset points",
        ha="right" if above else "left",
        va="center",
        fontsize=9,
    )


def _name(axes: Axes, flights: list[Flight]) -> None:
    """Label the points without overlaps; to the right where another point is close on the left."""
    places = np.log10([(flight.rmse_sides, flight.shape_error) for flight in flights])
    for flight, (x, y) in zip(flights, places, strict=True):
        dx = places[:, 0] - x
        stack = np.sort(places[np.abs(dx) < 0.1, 1])
        level = np.abs(places[:, 1, None] - stack).min(axis=1) < LINE
        right = bool((level & (dx < -0.1) & (dx > -0.7)).any())
        height = stack.mean() + LINE * (np.searchsorted(stack, y) - (stack.size - 1) / 2)
        missing = f" (finds {flight.recall:.0%})" if flight.recall < 0.995 else ""
        axes.annotate(
            flight.name + missing,
            (flight.rmse_sides, 10**height),
            (8 if right else -8, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            fontsize=9,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": PAPER, "edgecolor": "none"},
            zorder=1.5,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--detectors", nargs="+", default=default_entrants())
    parser.add_argument("--settle", type=float, default=40.0, help="simulated seconds before the averaging")
    parser.add_argument("--average", type=float, default=30.0, help="simulated seconds averaged over")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--figure", type=Path, default=FIGURE)
    options = parser.parse_args()
    tree = settled_tree() | {"duration_s": options.settle + options.average}
    kinds = (False, True)
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        lines = [
            pool.map(partial(fly_erring, tree=tree, settle_s=options.settle, fixed=fixed), SIGMAS)
            for fixed in kinds
        ]
        results = pool.map(partial(fly_detector, tree=tree, settle_s=options.settle), options.detectors)
        drawn = [list(line) for line in lines]
        flights = list(results)
    print_table([*flights, *(point for line in drawn for point in line)])
    draw(flights, drawn, options.figure)


if __name__ == "__main__":
    main()
