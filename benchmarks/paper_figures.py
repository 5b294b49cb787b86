"""Compare the paper's two simulation figures (TCST 2019) with ours, panel by panel.

```sh
export OPENBLAS_NUM_THREADS=1
python benchmarks/paper_figures.py            # prints the tables, draws nothing
python benchmarks/paper_figures.py --write    # and puts them into docs/paper.md, with the pictures
```

The runs use exact image points and the published starts, and take half a minute. Published values are read
off the plots (`benchmarks/paper_figures.toml`).

- *Fig. 4*, the triangle, at the paper's pace: k = 0.0125 /s is the gain at which the fastest robot drives as
  in the published plot, just below 0.05 m/s. It is the built-in scenario at an eighth of its speed.
- *Fig. 5*, the star, from the published places and heights of the cameras. The initial control sets are not
  published, except that they are the robots nearer to the image centre than a threshold. One threshold,
  0.7565 of the half view, and the heights in the order 12.4, 15.8, 15.3 m give sets of 7, 9 and 6 robots and
  the published V. There are two runs: by that threshold, and by the protocol that keeps TC1-TC5.
"""

import argparse
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import paper_panels

from skyherd.analysis.dwell_time import estimate_dwell_time
from skyherd.analysis.history import History, make_history
from skyherd.datasets import Mission, load_mission
from skyherd.geometry import to_complex
from skyherd.loop import run_steps

DOCS = Path(__file__).parent.parent / "docs"
BEGIN, END = "<!-- panels: begin -->", "<!-- panels: end -->"
PUBLISHED: dict[str, Any] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))

PACE = 8
"""Speed of the built-in triangle over that of the paper's robots. Derived from the gain above."""

THRESHOLD = 0.7565
"""Safety radius of Fig. 5, in halves of the view. Derived: 0.755 to 0.758 give V = 197.9 m² at the start."""

HEIGHTS_M = (12.4, 15.8, 15.3)
"""Heights of the cameras of Fig. 5 at the start, by unit: the order in which one threshold gives that V."""


BETWEEN = " / "
"""Separator of the values of the two runs of Fig. 5."""


class Row(NamedTuple):
    """A number of a panel: the published value, ours, and the reason for a difference."""

    panel: str
    published: str
    ours: str
    remark: str = ""


def figure4_mission() -> Mission:
    """Return the triangle at the paper's speed, for as long as the camera's rotation was plotted."""
    published, step_s = PUBLISHED["figure4"], 0.4
    turn_degps = published["camera_turn_deg"] / published["turn_s"]
    flight = {"speed_mps": 0.25, "climb_gain_mps": 2.0, "lateral_gain_mps": 4.0}
    return load_mission(
        "triangle",
        [
            "perception=ideal",
            f"duration_s={published['turn_s']}",
            f"step_s={step_s}",
            f"units.0.frame_rate_hz={1 / step_s}",
            f"control.k={0.1 / PACE}",
            f"control.k_omega={0.4 / PACE}",
            "control.b_th=0",
            f"units.0.camera.half_angle_deg={PUBLISHED['figure5']['half_angles_deg'][0]}",
            f"units.0.flight.yaw_rate_degps={turn_degps}",
            *(f"units.0.flight.{key}={value / PACE}" for key, value in flight.items()),
        ],
    )


def figure5_mission(kind: str) -> Mission:
    """Return the star from the published start, by the safety radius or by the protocol (`tree`)."""
    settings = [
        "perception=ideal",
        "duration_s=150",
        "control.b_th=0",
        f"selection.kind={kind}",
        f"selection.radius={THRESHOLD if kind == 'radius' else 0.92}",
    ]
    for unit, height_m in enumerate(HEIGHTS_M):
        flight = f"units.{unit}.flight"
        settings += [f"units.{unit}.height_m={height_m}", f"{flight}.desired_radius=0.7"]
        settings += [f"units.{unit}.camera.principal_point_px=[399.5, 399.5]"]
        settings += [f"{flight}.kind=keep-in-view"] if kind == "tree" else []
    return load_mission("star", settings)


def run(mission: Mission) -> History:
    """Run a mission from start to finish and return its steps."""
    return make_history(mission, run_steps(mission))


def at(history: History, time_s: float) -> int:
    """Return the step at a time."""
    return int(np.searchsorted(history.times_s, time_s - 1e-9))


def figure4_rows(history: History) -> list[Row]:
    """Return the rows of Fig. 4."""
    told = PUBLISHED["figure4"]
    ends_m = np.linalg.norm(history.positions_m[-1] - np.array(told["final_positions_m"]), axis=1)
    camera, middle = to_complex(history.unit_positions_m[:, 0]), to_complex(history.positions_m).mean(axis=1)
    laps = abs(np.unwrap(np.angle(camera - middle))[[0, -1]] @ [-1, 1]) / (2 * np.pi)
    points, size_px = history.traces[0].points_px, history.mission.scenario.units[0].camera.size_px
    middle_px = complex(*[(size - 1) / 2 for size in size_px])
    farthest = float(np.nanmax(np.abs(points - middle_px))) / (min(size_px) / 2)
    formed = at(history, told["formed_s"])
    turned_deg = float(np.degrees(history.yaws_rad[-1, 0]))
    scales, rotations_deg = history.scales[:, 0], np.degrees(history.rotations_rad[:, 0])
    heights_m = history.heights_m[:, 0]
    free = "half angle of Fig. 5, 39 degrees; the margin is not published"
    return [
        Row("paths: ends of the six robots", "six points", f"within {ends_m.max():.3f} m"),
        Row("paths: start of the camera", "(0, 0)", "(0, 0)", "set"),
        Row(
            "paths: camera",
            "the perimeter, more than one lap",
            f"{laps:.1f} laps",
            "speed is an input",
        ),
        Row(
            "linear velocity",
            f"below {told['speed_below_mps']} m/s",
            f"at most {np.abs(history.v_mps).max():.3f} m/s",
            "defines the gain",
        ),
        Row("angular velocity", "no number", f"{np.abs(history.omega_radps).max():.3f} rad/s at most"),
        Row(
            "image traces",
            "good visibility of all robots",
            f"all six in every image, within {farthest:.2f} of the half view",
        ),
        Row("V at the start", f"{told['V_start_m2']} m²", f"{history.V[0]:.1f} m²"),
        Row(f"V after {told['formed_s']:g} s", "near 0", f"{history.V[formed]:.2f} m²"),
        Row("V at the end", "0", f"{history.V[at(history, told['duration_s'])]:.0e} m² after 700 s"),
        Row("scale", f"{told['final_scale']} at the end", f"{scales[0]:.2f} to {scales[-1]:.2f}"),
        Row(
            "rotation",
            "no number",
            f"{rotations_deg[0]:.1f} to {rotations_deg[-1]:.1f} degrees",
            "of our template",
        ),
        Row(
            "camera height",
            "{} to {} m".format(*told["camera_heights_m"]),
            f"{heights_m[0]:.1f} to {heights_m[-1]:.1f} m, {heights_m.min():.1f} m in between",
            free,
        ),
        Row(
            "camera rotation",
            f"{told['camera_turn_deg']:g} degrees in 800 s",
            f"{turned_deg:.0f} degrees",
            "set",
        ),
    ]


def both_ways(form: str, values: Iterable[Any]) -> str:
    """Return a text for each of the two runs of Fig. 5, or one if both are equal."""
    texts = dict.fromkeys(form.format(value) for value in values)
    return BETWEEN.join(texts)


def listed(values: Iterable[float], digits: int = 1) -> str:
    """Return numbers in a row."""
    return ", ".join(f"{value:.{digits}f}" for value in values)


def robot_rows(runs: tuple[History, History]) -> list[Row]:
    """Return the rows of the robot panels of Fig. 5."""
    fastest = [np.abs(each.v_mps).max() for each in runs]
    quickest = [np.abs(each.omega_radps).max() for each in runs]
    scales = [
        f"{listed(each.scales[each.ready_row or 0], 2)} to {each.shape_scale[-1]:.3f} m, "
        f"{np.ptp(each.scales[-1]):.1g} m apart"
        for each in runs
    ]
    apart_deg = [np.degrees(np.ptp(each.rotations_rad[-1])) for each in runs]
    return [
        Row("paths: shape at the end", "the star", both_ways("shape error {:.0e}", end_errors(runs))),
        Row(
            "linear velocities",
            "no number; they jump",
            both_ways("{:.2f} m/s at most", fastest),
            "limit of our wheels",
        ),
        Row("angular velocities", "no number; they jump", both_ways("{:.2f} rad/s at most", quickest)),
        Row("scales of the parts", "equal at the end", both_ways("{}", scales)),
        Row("rotations of the parts", "equal at the end", both_ways("{:.1g} degrees apart", apart_deg)),
        Row("template", "eight-pointed star, radii 8 and 4.12", "the same", "set"),
        Row(
            "image traces",
            "no number",
            both_ways(
                "{} of 16 robots at the end", [listed(each.controlled[-1].sum(axis=1), 0) for each in runs]
            ),
            "control sets",
        ),
    ]


def end_errors(runs: tuple[History, History]) -> list[float]:
    """Return the shape errors at the end."""
    return [float(each.shape_error[-1]) for each in runs]


def topology_rows(runs: tuple[History, History]) -> list[Row]:
    """Return the rows of V, the Lyapunov function, in Fig. 5, and of the changes of the topology."""
    sets = ", ".join(str(count) for count in runs[0].controlled[0].sum(axis=1))
    switches = [(each.controlled[1:] != each.controlled[:-1]).any(axis=(1, 2)).sum() for each in runs]
    dwell = [estimate_dwell_time(each) for each in runs]
    told = [f"{each.mean_s:.1f} s on average, τ_d {each.needed_s:.1f} s" for each in dwell]
    return [
        Row(
            "V at the start",
            f"{PUBLISHED['figure5']['V_start_m2']:g} m²",
            both_ways("{:.1f} m²", [each.V[each.ready_row or 0] for each in runs]),
            f"sets of {sets} robots; protocol: once its tree is complete",
        ),
        Row(
            "V over time",
            "to 0, with jumps",
            both_ways("{:.0e} m² at the end", [each.V[-1] for each in runs]),
        ),
        Row("changes of the topology", "some, no number", both_ways("{}", switches)),
        Row("dwell time", "no number", both_ways("{}", told), "[Proposition 1](topology.md#dwell-time)"),
    ]


def camera_rows(runs: tuple[History, History]) -> list[Row]:
    """Return the rows of the camera panels of Fig. 5."""
    told = PUBLISHED["figure5"]
    speeds = [paper_panels.camera_speeds_mps(each)[-1].max() for each in runs]
    turned_deg = [np.degrees(np.ptp(each.yaws_rad, axis=0)).max() for each in runs]
    return [
        Row("paths: starts of the cameras", "three points", "the same", "set"),
        Row(
            "camera heights at the start",
            f"{listed(told['camera_heights_m'])} m, order not published",
            f"{listed(runs[0].heights_m[0])} m",
            "input; order determined by V",
        ),
        Row(
            "camera heights at the end",
            f"near {told['settled_height_m']:g} m",
            both_ways("{} m", [listed(each.heights_m[-1]) for each in runs]),
            "not matched: control sets and margin are not published",
        ),
        Row("camera speeds", "0 at the end", both_ways("{:.3f} m/s at the end", speeds)),
        Row("camera rotations", "none", both_ways("{:.0f} degrees", turned_deg)),
    ]


def figure5_rows(radius: History, tree: History) -> list[Row]:
    """Return the rows of Fig. 5: by the safety radius, and by the protocol."""
    runs = radius, tree
    return [*robot_rows(runs), *topology_rows(runs), *camera_rows(runs)]


def is_compared(row: Row) -> bool:
    """Return whether the panel has a published number that is no input of the run."""
    return not row.published.startswith("no number") and row.remark != "set"


def table(rows: list[Row]) -> str:
    """Return the compared rows as a Markdown table."""
    lines = [f"| {' | '.join(row)} |" for row in rows if is_compared(row)]
    return "\n".join(["| panel | published | ours | remark |", "|---|---|---|---|", *lines])


def table_both_ways(rows: list[Row]) -> str:
    """Return the compared rows of Fig. 5 as a Markdown table with a column for each of the two runs."""
    lines = ["| panel | published | safety radius | protocol | remark |", "|---|---|---|---|---|"]
    for row in filter(is_compared, rows):
        radius, _, tree = row.ours.partition(BETWEEN)
        lines.append(f"| {row.panel} | {row.published} | {radius} | {tree or radius} | {row.remark} |")
    return "\n".join(lines)


def page(figure4: History, radius: History, tree: History) -> str:
    """Return the part of docs/paper.md on both figures."""
    return f"""\
### Fig. 4: one camera, six robots

![Panels of Fig. 4 by skyherd, with published numbers in red](figure4_panels.png)

{table(figure4_rows(figure4))}

### Fig. 5: three cameras, sixteen robots

The [topology page](topology.md#the-papers-star) has the panels of the protocol.

![Panels of Fig. 5 by skyherd, with published numbers in red](figure5_panels.png)

{table_both_ways(figure5_rows(radius, tree))}
"""


def main() -> None:
    """Read the command line, run the figures and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write", action="store_true", help="into docs/: the tables, and the pictures")
    options = parser.parse_args()
    figure4 = run(figure4_mission())
    radius, tree = (run(figure5_mission(kind)) for kind in ("radius", "tree"))
    text = page(figure4, radius, tree)
    print(text)
    if options.write:
        paper_panels.figure4(figure4, PUBLISHED["figure4"], DOCS / "figure4_panels.png")
        paper_panels.figure5(radius, PUBLISHED["figure5"], DOCS / "figure5_panels.png")
        paper_panels.figure5(tree, PUBLISHED["figure5"], DOCS / "figure5_protocol.png")
        doc = DOCS / "paper.md"
        before, rest = doc.read_text("utf-8").split(BEGIN)
        doc.write_text(f"{before}{BEGIN}\n\n{text}\n{END}{rest.split(END)[1]}", "utf-8")


if __name__ == "__main__":
    main()
