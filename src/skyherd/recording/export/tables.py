"""Tables of a run: their columns, and the rows of each record."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from skyherd.geometry import Array
from skyherd.messages import Detections, Quality
from skyherd.messages.detections import CORNER_COLUMNS, STD_COLUMNS
from skyherd.recording.export.recorded_run import Commanded, Moment, Seen, Truth

Kind = Literal["int", "float", "text", "bool"]
"""Type of a column's values."""

Rows = dict[str, Any]
"""Values of new rows by column: an array or a list (N,), or one value for all rows."""


class Column(NamedTuple):
    """A column of a table: its name with the unit, the type of its values, and its meaning."""

    name: str
    kind: Kind
    meaning: str


@dataclass(frozen=True)
class TableSpec:
    """A table: its name, the meaning of a row, and its columns."""

    name: str
    row: str
    columns: tuple[Column, ...]

    @property
    def meanings(self) -> dict[str, str]:
        """Meaning of each column."""
        return {column.name: column.meaning for column in self.columns}


_UNIT = Column("unit_id", "int", "unit")
_CAPTURED = Column("time_s", "float", "time of the image since the start of the run")
_TIME = Column("time_s", "float", "time since the start of the run")
_ROBOT = Column("robot_id", "int", "robot, by the id of its marker")

IMAGES = TableSpec(
    "images",
    "an image",
    (
        _UNIT,
        _CAPTURED,
        Column("decided_s", "float", "time of the decision on it"),
        Column("width_px", "int", "width"),
        Column("height_px", "int", "height"),
        Column("markers", "int", "number of detected markers"),
    ),
)

COVARIANCE_COLUMNS = ("cov_u_v_px2", "cov_u_heading_px_deg", "cov_v_heading_px_deg")
"""Columns of the covariances between u, v and heading; empty where the detector does not state them."""

DETECTIONS = TableSpec(
    "detections",
    "a marker in an image",
    (
        _UNIT,
        _CAPTURED,
        Column("id", "int", "marker; an id may occur twice in an image"),
        Column("u_px", "float", "centre, to the right; an integer is a pixel centre"),
        Column("v_px", "float", "centre, down"),
        Column("heading_deg", "float", "forward axis, from +u to +v"),
        Column("side_px", "float", "side of the black square"),
        *(Column(name, "float", "standard deviation, empty if unknown") for name in STD_COLUMNS),
        *(Column(name, "float", "covariance, empty if unknown") for name in COVARIANCE_COLUMNS),
        Column("quality", "text", "corners, robust or photometric"),
        *(
            Column(name, "float", "corner of the black square, the two front ones first")
            for name in CORNER_COLUMNS
        ),
    ),
)

GOALS = TableSpec(
    "goals",
    "a goal that a unit sends to a robot",
    (
        _UNIT,
        _CAPTURED,
        _ROBOT,
        Column("rho_px", "float", "distance from the robot to its desired point"),
        Column("bearing_deg", "float", "direction of that point: 0 ahead, positive to the left"),
        Column("side_px", "float", "side of the robot's marker, in the same image"),
    ),
)

BODIES = TableSpec(
    "bodies",
    "a body near a robot, for avoidance",
    (
        _UNIT,
        _CAPTURED,
        _ROBOT,
        Column("other_id", "int", "the other body: a robot, or negative for other bodies"),
        Column("distance_sides", "float", "distance of the centres, in marker sides"),
        Column("bearing_deg", "float", "direction of the other body: 0 ahead, positive to the left"),
    ),
)

CONTROLLED = TableSpec(
    "controlled",
    "a robot that a unit controls, by the unit's report",
    (_UNIT, _CAPTURED, _ROBOT, Column("secure", "bool", "whether it is inside the safety radius")),
)

COMMANDS = TableSpec(
    "commands",
    "a wheel command",
    (
        _TIME,
        _ROBOT,
        Column("v_mps", "float", "forward speed"),
        Column("omega_degps", "float", "turn rate, counter-clockwise from above"),
        Column("state", "text", "driving, or the reason to stand still"),
        Column("armed", "bool", "whether the robot is armed; empty in a simulated run"),
        Column("image_age_s", "float", "age of the newest known image; empty in a simulated run"),
    ),
)

FLIGHTS = TableSpec(
    "flights",
    "a flight command of a unit",
    (
        _UNIT,
        _CAPTURED,
        Column("u_mps", "float", "velocity along the image's +u"),
        Column("v_mps", "float", "velocity along the image's +v"),
        Column("climb_mps", "float", "upward velocity"),
        Column("yaw_rate_degps", "float", "turn rate, counter-clockwise from above"),
        Column("zoom_rate_ps", "float", "relative change of the focal length, 1/s"),
    ),
)

TRUE_ROBOTS = TableSpec(
    "true_robots",
    "the true pose of a robot",
    (
        _TIME,
        _ROBOT,
        Column("x_m", "float", "place of its marker on the ground"),
        Column("y_m", "float", "place of its marker on the ground"),
        Column("heading_deg", "float", "counter-clockwise from +x"),
        Column("role", "int", "row of its point in the template"),
    ),
)

TRUE_UNITS = TableSpec(
    "true_units",
    "the true pose of a unit",
    (
        _TIME,
        _UNIT,
        Column("x_m", "float", "ground point below the camera"),
        Column("y_m", "float", "ground point below the camera"),
        Column("height_m", "float", "height above the ground"),
        Column("yaw_deg", "float", "direction of the image's +u on the ground, counter-clockwise from +x"),
        Column("tilt_u_deg", "float", "tilt of the scene about the camera's u axis"),
        Column("tilt_v_deg", "float", "tilt of the scene about the camera's v axis"),
        Column("zoom", "float", "factor on the focal length"),
    ),
)

METRICS = TableSpec(
    "metrics",
    "the ground-truth metrics at one time",
    (
        _TIME,
        Column("lyapunov_m2", "float", "the Lyapunov function V"),
        Column("shape_error", "float", "RMS distance to the shape over the RMS radius"),
        Column("scale_m", "float", "metres per template unit"),
        Column("rotation_deg", "float", "rotation of the template, counter-clockwise"),
        Column("min_separation_m", "float", "minimum distance between two robots"),
        *(Column(f"tc{k}", "bool", f"whether condition TC{k} holds") for k in range(1, 6)),
    ),
)

SEEN_TABLES = (IMAGES, DETECTIONS, GOALS, BODIES, CONTROLLED, COMMANDS)
"""Tables of every run."""

SIMULATED_TABLES = (FLIGHTS, TRUE_ROBOTS, TRUE_UNITS, METRICS)
"""Further tables of a simulated run."""


def tables_of(kind: str) -> tuple[TableSpec, ...]:
    """Return the tables of a run of a kind, `simulated` or `live`."""
    return SEEN_TABLES + (SIMULATED_TABLES if kind == "simulated" else ())


def rows_of_moment(moment: Moment) -> Iterator[tuple[TableSpec, Rows]]:
    """Yield the tables to which a record adds rows, and these rows."""
    if isinstance(moment, Seen):
        yield from _rows_of_image(moment)
    elif isinstance(moment, Commanded):
        yield (
            COMMANDS,
            {
                "time_s": moment.time_s,
                "robot_id": moment.ids,
                "v_mps": moment.v_mps,
                "omega_degps": np.degrees(moment.omega_radps),
                "state": list(moment.states),
                "armed": moment.armed,
                "image_age_s": moment.image_age_s,
            },
        )
    else:
        yield from _rows_of_truth(moment)


def _rows_of_image(seen: Seen) -> Iterator[tuple[TableSpec, Rows]]:
    found, goals, near, report, flight = (
        seen.detections,
        seen.goals,
        seen.proximity,
        seen.report,
        seen.flight,
    )
    place = {"unit_id": found.unit_id, "time_s": seen.time_s}
    width, height = found.image_size_px.tolist()
    image = {"decided_s": seen.decided_s, "width_px": int(width), "height_px": int(height)}
    yield IMAGES, place | image | {"markers": [len(found)]}
    yield DETECTIONS, place | _detection_rows(found)
    if goals is not None:
        yield (
            GOALS,
            place
            | {
                "robot_id": goals.ids,
                "rho_px": goals.rho_px,
                "bearing_deg": np.degrees(goals.bearings_rad),
                "side_px": goals.sides_px,
            },
        )
    if near is not None:
        yield (
            BODIES,
            place
            | {
                "robot_id": near.robot_ids,
                "other_id": near.other_ids,
                "distance_sides": near.distances_sides,
                "bearing_deg": np.degrees(near.bearings_rad),
            },
        )
    if report is not None:
        secure = np.isin(report.controlled_ids, report.secure_ids)
        yield CONTROLLED, place | {"robot_id": report.controlled_ids, "secure": secure}
    if flight is not None:
        u_mps, v_mps = flight.lateral_mps.tolist()
        yield (
            FLIGHTS,
            place
            | {
                "u_mps": [u_mps],
                "v_mps": v_mps,
                "climb_mps": flight.climb_mps,
                "yaw_rate_degps": float(np.degrees(flight.yaw_rate_radps)),
                "zoom_rate_ps": flight.zoom_rate_ps,
            },
        )


def _detection_rows(found: Detections) -> Rows:
    to_degrees = np.degrees(1.0)
    covariances: Array = found.covariances * np.outer((1, 1, to_degrees), (1, 1, to_degrees))
    known = np.asarray(found.covariances.any(axis=(1, 2)))[:, None]
    stds = np.sqrt(np.where(known, np.diagonal(covariances, axis1=1, axis2=2), np.nan))
    pairs = np.where(known, covariances[:, (0, 0, 1), (1, 2, 2)], np.nan)
    corners = found.corners_px.reshape(-1, len(CORNER_COLUMNS))
    return {
        "id": found.ids,
        "u_px": found.centers_px[:, 0],
        "v_px": found.centers_px[:, 1],
        "heading_deg": np.degrees(found.headings_rad),
        "side_px": found.sides_px,
        **dict(zip(STD_COLUMNS, stds.T, strict=True)),
        **dict(zip(COVARIANCE_COLUMNS, pairs.T, strict=True)),
        "quality": [Quality(quality).name.lower() for quality in found.qualities.tolist()],
        **dict(zip(CORNER_COLUMNS, corners.T, strict=True)),
    }


def _rows_of_truth(truth: Truth) -> Iterator[tuple[TableSpec, Rows]]:
    yield (
        TRUE_ROBOTS,
        {
            "time_s": truth.time_s,
            "robot_id": truth.ids,
            "x_m": truth.positions_m[:, 0],
            "y_m": truth.positions_m[:, 1],
            "heading_deg": np.degrees(truth.headings_rad),
            "role": truth.roles,
        },
    )
    fleet, metrics = truth.fleet, truth.metrics
    yield (
        TRUE_UNITS,
        {
            "time_s": truth.time_s,
            "unit_id": np.arange(fleet.heights_m.size),
            "x_m": fleet.positions_m[:, 0],
            "y_m": fleet.positions_m[:, 1],
            "height_m": fleet.heights_m,
            "yaw_deg": np.degrees(fleet.yaws_rad),
            "tilt_u_deg": np.degrees(fleet.tilts_rad[:, 0]),
            "tilt_v_deg": np.degrees(fleet.tilts_rad[:, 1]),
            "zoom": fleet.zooms,
        },
    )
    yield (
        METRICS,
        {
            "time_s": [truth.time_s],
            "lyapunov_m2": metrics.V,
            "shape_error": metrics.shape.error,
            "scale_m": metrics.shape.scale,
            "rotation_deg": float(np.degrees(metrics.shape.rotation_rad)),
            "min_separation_m": metrics.min_separation_m,
            **{f"tc{k}": getattr(metrics.conditions, f"tc{k}") for k in range(1, 6)},
        },
    )
