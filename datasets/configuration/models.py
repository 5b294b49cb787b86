"""Keys of the scenario file, with their meaning, unit and allowed values."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.bodies import Bodies
from skyherd.datasets.configuration.body_models import AvoidanceModel, RolesModel, SizeModel
from skyherd.datasets.configuration.fields import (
    MAX_ROBOTS,
    Fraction,
    Height,
    Model,
    Name,
    NotNegative,
    Positive,
    Seed,
)
from skyherd.datasets.configuration.intervention_models import (
    MAX_UNITS,
    CameraIntervention,
    ControlIntervention,
    Intervention,
    LifeIntervention,
    NetworkIntervention,
    TemplateIntervention,
    UnitIntervention,
)
from skyherd.datasets.configuration.robot_models import MarkerModel, ObstacleModel, RobotsModel
from skyherd.datasets.configuration.scene_models import GroundModel, OccluderModel, SensorModel
from skyherd.datasets.configuration.template_models import LaterModel, TemplateModel
from skyherd.datasets.configuration.unit_models import UnitModel
from skyherd.datasets.configuration.validation import shown
from skyherd.errors import InputError, join_errors
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.text import one_of

MAX_INTERVENTIONS = 10_000
"""Maximum number of interventions. Chosen: a slider that is moved at each step for a quarter of an hour."""

RATE_ROUNDING = 1e-9
"""Tolerance of the number of images per time step above 1. Chosen: rounding of `frame_rate_hz * step_s`,
such as 10 times 0.1."""


METHODS = (
    "similarity",
    "complex-laplacian",
    "matrix-weighted",
    "affine-modules",
    "affine-stress",
    "bearing-only",
    "bearings-with-ranges",
    "distances",
    "angles",
    "distance-ratios",
    "mean-shift",
)
"""Control laws of the robots: skyherd's, and those from the literature (`skyherd.sim.baseline_laws`)."""

OWN_METHOD = ":"
"""Separator in the name of a user-defined law, `module:factory`."""

MOVING_METHOD = "complex-laplacian"
"""The one law from the literature that can move the shape."""


def _check_method(method: str) -> str:
    if method not in METHODS and OWN_METHOD not in method:
        raise InputError("", f"no law {shown(method)}", f"{one_of(method, METHODS)}, or module:factory")
    return method


class ControlModel(Model):
    """Control law of the robots, and its gains."""

    method: Annotated[str, AfterValidator(_check_method)] = Field(
        "similarity",
        description="skyherd's law, `similarity`; or a law that is given the true positions: from the "
        f"literature ({', '.join(METHODS[1:])}), or your own as `module:factory`",
    )
    told_noise_m: NotNegative = Field(
        0.0,
        description="m; standard deviation of an additional error of the robots' positions, along x and "
        "along y and drawn at each step: as units see them, or as a law from the literature is given them",
    )
    gains: Literal["marker", "pixel"] = Field(
        "marker", description="unit of image distances in the law: marker sides, or pixels as in the paper"
    )
    k: Positive = Field(0.1, description="1/s; with marker gains: speed for each metre to the goal")
    k_v: Positive = Field(0.001, description="m/s/px; with pixel gains: speed for each pixel to the goal")
    k_omega: Positive = Field(0.4, description="1/s; turn rate for each radian between heading and goal")
    b_th: NotNegative = Field(
        0.01, description="marker sides, or px with pixel gains; robots nearer to their goal than this stop"
    )
    latency_compensation: bool = Field(
        False,
        description="latency compensation: whether robots subtract their motion since the image",
    )
    rectify: bool = Field(
        True,
        description="whether units estimate tilt and lens of their cameras, and correct for them",
    )
    neighbors: Annotated[int, Field(ge=1, le=MAX_ROBOTS)] = Field(
        3, description="number of nearest robots to which a unit sends each robot the distances"
    )
    camera_check: bool = Field(
        True,
        description="whether units compare their images with the commanded motion, and send nothing while "
        "their camera seems to be frozen or to replay old images",
    )
    tell_apart: bool = Field(
        True,
        description="whether units make a robot whose id they see at several places turn, and take the "
        "marker that turns as the robot",
    )


class SelectionModel(Model):
    """Robots that a unit controls: all inside its safety radius, or by agreement along a tree of units."""

    kind: Literal["radius", "tree", "radius-then-tree"] = Field(
        "radius",
        description="all robots inside the radius, or TC1-TC5 kept by the units' tree protocol, or "
        "the first until "
        "V stops falling, then the second",
    )
    share: Literal["leverage", "nearest"] = Field(
        "leverage",
        description="tree: which pair of robots two neighbours share: that which binds them best, or "
        "the nearest",
    )
    firm: Fraction = Field(
        0.2,
        description="tree: while two units agree more slowly than this times k, they fly to see a "
        "better pair",
    )
    radius: Annotated[FiniteFloat, Field(ge=0.01, le=1.5)] = Field(
        0.85, description="safety radius about the image's middle, in halves of its shorter side"
    )
    hysteresis: NotNegative = Field(
        0.06, description="a controlled robot is given up at radius times (1 + hysteresis)"
    )
    dwell_s: Positive = Field(2.0, description="s; least time between two changes of the topology")
    silence_s: Positive = Field(
        3.0, description="s; tree: a unit counts as dead this long after its last report"
    )


class AutopilotModel(Model):
    """Limits enforced by the units' autopilots."""

    min_height_m: Height = Field(3.0, description="m; least height")
    max_height_m: Height = Field(100.0, description="m; greatest height")
    max_speed_mps: Positive = Field(2.0, description="m/s; limit on the horizontal speed")
    max_climb_mps: Positive = Field(1.0, description="m/s; limit on climbing and sinking")
    max_yaw_rate_degps: Positive = Field(30.0, description="deg/s; limit on turning about the vertical")

    @model_validator(mode="after")
    def _room(self) -> Self:
        if self.min_height_m >= self.max_height_m:
            what = f"{self.min_height_m:g}, with max_height_m {self.max_height_m:g}"
            raise InputError("min_height_m", what, "less than max_height_m")
        return self


class NetworkModel(Model):
    """Losses and delays of images and messages, drawn from the seed."""

    frame_loss: Fraction = Field(0.0, description="share of images that are lost")
    message_loss: Fraction = Field(
        0.0, description="share of messages that are lost, drawn for each receiver"
    )
    range_m: Positive | None = Field(
        None,
        description="m; distance on the ground up to which units receive each other; no limit if left out",
    )
    relay: bool = Field(
        True,
        description="whether units relay reports to units out of the sender's range",
    )
    relay_s: NotNegative = Field(0.02, description="s; delay of a relayed report")
    delay_s: NotNegative = Field(
        0.0,
        description="s; largest delay of a message, drawn for each receiver; later ones may overtake earlier",
    )
    repeats: Fraction = Field(0.0, description="share of messages that arrive twice")


class GoalModel(Model):
    """Criterion of convergence: the shape error stays below a limit until the end of the run."""

    shape_error: Positive = Field(
        0.01,
        description="RMS distance to the best-fitting shape, over the formation's RMS radius, to stay under",
    )
    hold_s: NotNegative = Field(
        5.0, description="s; how long before the run's end it must have stayed under that"
    )


class VideoModel(Model):
    """Speed and end of the video."""

    end: Literal["held", "run"] = Field(
        "held",
        description="end of the video: `after_s` after the shape has been held for `goal.hold_s`, or with "
        "the run. If the shape is lost, the video goes on. It shows every change of shape, outage and zoom",
    )
    after_s: NotNegative = Field(3.0, description="s; simulated time shown after the shape is held")
    speed: Annotated[FiniteFloat, Field(ge=0.1, le=1000)] = Field(
        4.0, description="simulated seconds in each second of the video"
    )


class Scenario(Model):
    """Scenario file: all inputs of a run."""

    @property
    def clocks_differ(self) -> bool:
        """True if a unit or a robot has a clock with an offset or a drift."""
        off = ((unit.clock_offset_s, unit.clock_drift_ppm) for unit in self.units)
        return any(map(any, off)) or bool(self.robots.clock_offset_s or self.robots.clock_drift_ppm)

    name: Name = Field(description="name of the scenario, and of its output folder")
    description: str = Field("", description="description of the scenario")
    seed: Seed = Field(1, description="seed of all random draws; same seed, same run")
    duration_s: Annotated[FiniteFloat, Field(ge=0.0001, le=86400)] = Field(description="s; simulated time")
    step_s: Annotated[FiniteFloat, Field(ge=0.0001, le=1)] = Field(
        0.1, description="s; time step of the world"
    )
    perception: Literal["rendered", "ideal", "noisy"] = Field(
        "rendered",
        description="detection of markers: in rendered images, exactly, or with the detector's "
        "measured noise",
    )
    detector: str = Field(
        "tracking", description="name of the marker detector, one of `skyherd.vision.detector_names()`"
    )
    template: TemplateModel = Field(description="the shapes to form")
    robots: RobotsModel = Field(description="the ground robots: starts and limits")
    marker: MarkerModel = Field(description="the markers on robots and obstacles")
    control: ControlModel = Field(ControlModel(), description="the law that moves the robots, and its gains")
    selection: SelectionModel = Field(
        SelectionModel(), description="selection of the robots that each unit controls"
    )
    roles: RolesModel = Field(
        RolesModel(), description="assignment of the robots to the points of the template"
    )
    size: SizeModel = Field(SizeModel(), description="size of the shape")
    avoidance: AvoidanceModel = Field(AvoidanceModel(), description="collision avoidance")
    units: list[UnitModel] = Field(min_length=1, max_length=MAX_UNITS, description="the aerial units")
    autopilot: AutopilotModel = Field(AutopilotModel(), description="limits that the units' autopilots keep")
    network: NetworkModel = Field(NetworkModel(), description="losses and delays of images and messages")
    sensor: SensorModel = Field(SensorModel(), description="sensors of the cameras")
    ground: GroundModel = Field(GroundModel(), description="the textured ground, and clutter on it")
    occluders: list[OccluderModel] = Field(
        default=[], max_length=1000, description="opaque shapes over markers"
    )
    obstacles: list[ObstacleModel] = Field(default=[], max_length=1000, description="static round bodies")
    goal: GoalModel = Field(GoalModel(), description="criterion of convergence")
    video: VideoModel = Field(VideoModel(), description="speed and end of the video")
    interventions: list[Intervention] = Field(
        default=[],
        max_length=MAX_INTERVENTIONS,
        description="changes of the running simulation, each at its time; the last one of a value counts",
    )

    @property
    def interventions_in_order(self) -> list[Intervention]:
        """The interventions by time; those of one time stay in the order of the file."""
        return sorted(self.interventions, key=lambda intervention: intervention.at_s)

    @property
    def later_shapes(self) -> list[tuple[str, LaterModel | TemplateIntervention]]:
        """Shapes after the first by time, of `template.then` and of interventions, each with its key."""
        shapes: list[tuple[str, LaterModel | TemplateIntervention]] = [
            (f"template.then.{number}", shape) for number, shape in enumerate(self.template.then)
        ]
        shapes += [
            (f"interventions.{number}", intervention)
            for number, intervention in enumerate(self.interventions)
            if isinstance(intervention, TemplateIntervention)
        ]
        return sorted(shapes, key=lambda shape: shape[1].at_s)

    def after(self, intervention: Intervention) -> "Scenario":
        """Return the scenario with the settings that an intervention changes; others stay the same objects.

        Interventions on robots, markers, the life of a unit and the shape change no settings.
        """
        match intervention:
            case UnitIntervention() | CameraIntervention():
                units = list(self.units)
                units[intervention.unit] = units[intervention.unit].with_values(intervention.changes)
                return self.model_copy(update={"units": units})
            case NetworkIntervention():
                return self.model_copy(
                    update={"network": self.network.model_copy(update=intervention.changes)}
                )
            case ControlIntervention():
                return self.model_copy(
                    update={"control": self.control.model_copy(update=intervention.changes)}
                )
            case _:
                return self

    def dead_units(self, time_s: float) -> list[int]:
        """Return the units that are dead at a time, s: killed and not revived, or in an outage.

        A unit that is revived does not return to the outage in which it was.
        """
        last: dict[int, LifeIntervention] = {}
        lives = [one for one in self.interventions if isinstance(one, LifeIntervention)]
        for intervention in sorted(lives, key=lambda one: one.at_s):
            if intervention.at_s <= time_s + TIME_TOLERANCE_S:
                last[intervention.unit] = intervention
        dead = []
        for unit, model in enumerate(self.units):
            kind, at_s = (last[unit].kind, last[unit].at_s) if unit in last else ("revive", -np.inf)
            outages = any(start <= time_s < end and start > at_s for start, end in model.outages)
            if kind == "kill" or outages:
                dead.append(unit)
        return dead

    @property
    def obstacles_by_id(self) -> list[ObstacleModel]:
        """The obstacles, ascending by the id of their markers."""
        return sorted(self.obstacles, key=lambda obstacle: obstacle.id)

    def make_bodies(self) -> Bodies:
        """Make the round bodies of robots and obstacles, the obstacles ascending by id."""
        side_m, obstacles = self.marker.side_m, self.obstacles_by_id
        return Bodies(
            radius_m=self.robots.body_radius_sides * side_m,
            obstacles_m=np.array([obstacle.position_m for obstacle in obstacles], dtype=float).reshape(-1, 2),
            obstacle_radii_m=np.array(
                [obstacle.radius_sides * side_m for obstacle in obstacles], dtype=float
            ),
        )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        problems = [
            problem.within_key(f"units.{number}")
            for number, unit in enumerate(self.units)
            for problem in self._unit_problems(unit)
        ]
        if problems:
            raise join_errors(problems)
        return self

    @model_validator(mode="after")
    def _possible_interventions(self) -> Self:
        problems: list[InputError] = []
        settings: Scenario = self
        numbers = {id(intervention): number for number, intervention in enumerate(self.interventions)}
        for intervention in self.interventions_in_order:
            found = list(settings.intervention_problems(intervention))
            key = f"interventions.{numbers[id(intervention)]}"
            problems += [problem.within_key(key) for problem in found]
            if not found:
                settings = settings.after(intervention)
        if problems:
            raise join_errors(problems)
        return self

    def intervention_problems(self, intervention: Intervention) -> Iterator[InputError]:
        """Yield the reasons, by key, why an intervention is impossible in this scenario.

        Markers and template points are not checked here, since they belong to the completed mission.
        """
        unit = getattr(intervention, "unit", 0)
        if unit >= len(self.units):
            yield InputError("unit", f"no unit {unit}", f"from 0 to {len(self.units) - 1}")
            return
        match intervention:
            case UnitIntervention():
                yield from self._unit_problems(self.after(intervention).units[unit])
            case CameraIntervention(distortion=lens) if (
                lens and self.units[unit].camera.lens != "perspective"
            ):
                yield InputError("distortion", "given for a lens that is not perspective", "leave it out")
            case CameraIntervention():
                key = next(
                    (key for key in ("distortion", "zoom", "aspect") if key in intervention.changes), ""
                )
                for problem in self._unit_problems(self.after(intervention).units[unit]):
                    yield InputError(key, problem.what, problem.allowed)
            case ControlIntervention():
                unused = {"k_v"} if self.control.gains == "marker" else {"k"}
                for key in sorted(unused & intervention.changes.keys()):
                    yield InputError(key, f"unused with control.gains {self.control.gains}", "leave it out")

    @model_validator(mode="after")
    def _fit_for_baseline(self) -> Self:
        """Reject settings that a law from the literature does not support."""
        parts = {
            "roles.exchange": self.roles.exchange,
            "template.then": self.template.then,
            "template.motion": self.template.motion and self.control.method != MOVING_METHOD,
            "control.gains": self.control.gains == "pixel",
        } | {
            f"interventions.{number}": isinstance(intervention, ControlIntervention | TemplateIntervention)
            for number, intervention in enumerate(self.interventions)
        }
        if self.control.method != "similarity" and (given := [name for name, on in parts.items() if on]):
            what = f"not supported by control.method {self.control.method}"
            raise join_errors(
                [InputError(key, what, "leave it out, or use the method similarity") for key in given]
            )
        return self

    @model_validator(mode="after")
    def _one_assignment(self) -> Self:
        """Reject an assignment of places for one of several shapes."""
        if self.roles.assigned != "none" and self.template.then:
            raise InputError(
                "roles.assigned", f"{self.roles.assigned}, with template.then", "none, or a single shape"
            )
        return self

    @model_validator(mode="after")
    def _possible_motion(self) -> Self:
        """Reject motions of the shape that units cannot lead, or that its given size excludes."""
        if self.template.motion and self.control.gains == "pixel":
            what = "given with control.gains pixel, whose speeds depend on unknown scales"
            raise InputError("template.motion", what, "leave it out, or use marker gains")
        is_given = self.size.unit_m is not None or self.size.spacing_sides is not None
        for number, motion in enumerate(self.template.motion):
            if motion.growth_percent_ps and is_given:
                where = f"template.motion.{number}.growth_percent_ps"
                what = f"{motion.growth_percent_ps:g}, but the size of the shape is given"
                raise InputError(where, what, "0, or no size.unit_m and size.spacing_sides")
        return self

    def _unit_problems(self, unit: UnitModel) -> Iterator[InputError]:
        low, high = self.autopilot.min_height_m, self.autopilot.max_height_m
        rate = unit.frame_rate_hz
        if not low <= unit.height_m <= high:
            what = f"{unit.height_m:g} is outside the autopilot's limits"
            yield InputError(
                "height_m", what, f"from autopilot.min_height_m to max_height_m: {low:g} to {high:g}"
            )
        if rate * self.step_s > 1 + RATE_ROUNDING:
            what = f"{rate:g} is more than one image in each step_s of {self.step_s:g}"
            yield InputError("frame_rate_hz", what, f"at most {1 / self.step_s:g}, or a smaller step_s")
        problems = (unit.camera.lens_problem(zoom) for zoom in unit.zooms())
        if problem := next(filter(None, problems), None):
            yield problem.within_key("camera")
