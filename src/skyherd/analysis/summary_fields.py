"""Labels and explanations of the summary's keys, and formatting of their values."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, isfinite

UNKNOWN = "not known"
"""Text of a value that is None or not a finite number."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Field:
    """A key of the summary as reports show it.

    Attributes:
        key: the key in `summary.json`.
        label: a name of a few words.
        unit: suffix of the value; empty for none.
        meaning: a sentence.
        kind: format of the value: `plain`, `angle` (degrees and radians), `share` (per cent), `error` (per
            cent, three digits) or `ids`.
        absent: text of a value that is None, where that does not mean unknown.
    """

    key: str
    label: str
    unit: str = ""
    meaning: str = ""
    kind: str = "plain"
    absent: str = UNKNOWN


TC_MEANINGS = (
    "Units that share two robots or more are neighbours; the graph of units is connected.",
    "Every robot is controlled by a unit.",
    "Neighbouring units share exactly two robots, others none.",
    "No robot is controlled by more than two units.",
    "The graph of units is a tree.",
)

"""Requirements of the paper's conditions TC1 to TC5 on a topology, in this order."""

TREE = "Tree of units"
"""Name of the group of keys that only missions with a tree of units have."""

GROUPS: Mapping[str, tuple[Field, ...]] = {
    "Outcome": (
        Field("converged", "Converged", "", "The shape error stayed below its goal to the end."),
        Field(
            "reached_s",
            "Time to the shape",
            "s",
            "Time since which the shape error stayed below its goal, from the start of the run.",
            absent="not reached",
        ),
        Field("verdict", "Verdict", "", "What happened and, if the shape was not reached, why."),
        Field("complete", "Complete", "", "The run reached its planned end, and its recording is intact."),
        Field(
            "shape_error",
            "Shape error",
            "",
            "RMS distance to the best-fitting copy of the shape, over the formation's RMS radius.",
            "error",
        ),
        Field(
            "goal_error_m",
            "Largest error of a goal",
            "m",
            "Distance on the ground from a desired point to the one of the robots' true positions.",
        ),
        Field(
            "scale",
            "Scale",
            "m/unit",
            "Metres on the ground per template unit; not prescribed.",
        ),
        Field(
            "rotation_rad",
            "Rotation",
            "",
            "Counter-clockwise from the template; not prescribed.",
            "angle",
        ),
        Field(
            "V_start",
            "Cost V at the start",
            "m²",
            "Lyapunov function: half the sum of squared distances to desired points, when robots start.",
        ),
        Field("V_end", "Cost V at the end", "m²", "Zero if every unit's robots are in the shape."),
    ),
    "Robots": (
        Field("min_separation_m", "Closest two robots", "m", "Between centres, over the whole run."),
        Field(
            "min_gap_m",
            "Least gap",
            "m",
            "Between the bodies of two robots, or of a robot and an obstacle; negative in a collision.",
        ),
        Field(
            "collisions",
            "Collisions",
            "",
            "Number of onsets of an overlap of two bodies; robots without a body are points.",
        ),
        Field(
            "uncommanded_robot_s",
            "Robots without a goal",
            "s",
            "Summed over all robots; they stand still.",
        ),
        Field(
            "role_exchanges",
            "Role exchanges",
            "",
            "Number of instants at which robots exchanged roles, including the initial assignment.",
        ),
        Field("path_length_m", "Distance travelled", "m", "All robots together."),
        Field(
            "shortest_path_m",
            "Shortest distance",
            "m",
            "Lower bound for all robots together: straight lines from the start into the shape.",
        ),
    ),
    "Vision": (
        Field(
            "detection_recall",
            "Markers detected",
            "",
            "Share of the markers of robots and obstacles that were whole in an image.",
            "share",
        ),
        Field("false_detections", "False detections", "", "Reported markers that do not exist."),
        Field("frames", "Images", "", "Total of all units."),
        Field(
            "perception", "Perception", "", "Detections from rendered images, or from exact or noisy truth."
        ),
    ),
    "Topology": (
        Field(
            "topology_changes",
            "Topology changes",
            "",
            "Number of instants at which a unit took or released a robot.",
        ),
        Field("p_violation_s", "Outside P", "s", "Time with any of TC1-TC5 violated."),
        *(
            Field(f"tc{number}_violation_s", f"TC{number} violated", "s", meaning)
            for number, meaning in enumerate(TC_MEANINGS, 1)
        ),
    ),
    "Dwell time": (
        Field(
            "dwell_min_s",
            "Shortest topology",
            "s",
            "Least time between two changes before the shape was formed.",
            absent="fewer than two changes",
        ),
        Field(
            "dwell_mean_s",
            "Average dwell time",
            "s",
            "Time until the shape was formed per change. More than τ_d suffices.",
            absent="no change",
        ),
        Field(
            "dwell_needed_s",
            "Required dwell time, τ_d",
            "s",
            "Estimate ln μ / λ₀ of a sufficient average (Proposition 1). 0: any dwell time suffices.",
            absent="none",
        ),
        Field(
            "switch_ratio",
            "Rise at a change, μ",
            "",
            "Greatest ratio of V after to V before. 1 or less: V rose at no change.",
            absent="no change",
        ),
        Field(
            "decay_rate_ps",
            "Decay rate, λ₀",
            "1/s",
            "Least decay rate of V between changes.",
            absent="V did not fall",
        ),
        Field(
            "dwell_bound_s",
            "Bound on τ_d",
            "s",
            "For any positions, from the eigenvalues of the run's topologies, if robots drive "
            "straight to their goals.",
            absent="none",
        ),
    ),
    TREE: (
        Field("ready_s", "Tree complete", "s", "Robots start to move, and violations count from here."),
        Field(
            "missing_robots",
            "Missing robots",
            "",
            "Finally without a unit, or not seen by their units for long.",
            "ids",
        ),
        Field(
            "unjoined_units",
            "Units outside the tree",
            "",
            "Living units that were not admitted until the end.",
            "ids",
        ),
    ),
    "Run": (
        Field("scenario", "Scenario"),
        Field("seed", "Seed", "", "The same scenario and seed give the same run."),
        Field("simulated_s", "Simulated time", "s"),
        Field("wall_s", "Computing time", "s"),
        Field("real_time_factor", "Real-time factor", "×", "Simulated time over computing time."),
        Field("steps", "Steps"),
        Field("loop_steps_per_s", "Steps computed", "per second"),
        Field("frames_per_s", "Images processed", "per second"),
    ),
}
"""All keys of the summary except the final positions, in the order shown."""


def value_text(field: Field, value: object) -> str:
    """Format a value with its unit, according to its field's kind.

    None is shown as `Field.absent`, NaN and infinity as `not known`.
    """
    if value is None:
        return field.absent
    if isinstance(value, float) and not isfinite(value):
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if field.kind == "ids" and isinstance(value, list):
        return ", ".join(str(item) for item in value) or "none"
    if not isinstance(value, int | float):
        return str(value)
    if field.kind == "angle":
        return f"{degrees(value):.1f}° ({number_text(value)} rad)".replace("-", "−")
    if field.kind == "share":
        return f"{100 * value:.5g} %"
    if field.kind == "error":
        return f"{100 * value:.3g} %"
    return f"{number_text(value)} {field.unit}".strip()


def number_text(value: float) -> str:
    """Format a finite number: an integer in full, else four digits, as `0.01235` or `1.887 × 10⁻⁸`."""
    mantissa, _, exponent = (str(value) if isinstance(value, int) else f"{value:.4g}").partition("e")
    power = f" × 10{str(int(exponent)).translate(_SUPERSCRIPTS)}" if exponent else ""
    return mantissa.replace("-", "−") + power
