"""The scenario file, key by key: what each means, its unit, and what is allowed."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.body_models import AvoidanceModel, RolesModel, SizeModel
from skyherd.datasets.configuration.fields import Coordinate, Fraction, Model, NotNegative, Point, Positive
from skyherd.datasets.configuration.scene_models import GroundModel, OccluderModel, SensorModel
from skyherd.datasets.configuration.unit_models import UnitModel

MarkerId = Annotated[int, Field(ge=0, lt=2**31)]


class ShapeModel(Model):
    """A shape: exactly one of `points`, `shape` and `image`."""

    points: list[Point] | None = Field(None, description="a point for each robot, x right, y up, any unit")
    shape: str | None = Field(None, description="a named shape, or a word such as word:SKY")
    image: str | None = Field(None, description="a PNG with every robot's marker in it, beside the scenario")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if sum(value is not None for value in (self.points, self.shape, self.image)) != 1:
            raise ValueError("give exactly one of points, shape and image")
        return self


class LaterModel(ShapeModel):
    """A shape that comes later."""

    at_s: Positive = Field(description="when it takes the place of the one before")


class TemplateModel(ShapeModel):
    """The shape to form, and those that come after it."""

    then: list[LaterModel] = Field([], max_length=100, description="later shapes, times ascending")


class ScatterModel(Model):
    """Random start: the template's points at `scale_m` metres a unit, each moved by up to `jitter_m`."""

    scale_m: Positive = Field(description="metres a template unit")
    jitter_m: NotNegative = Field(description="largest displacement along x and along y")
    rotation_deg: FiniteFloat = Field(0.0, description="turn of the shape, counter-clockwise")
    spacing_m: NotNegative = Field(0.0, description="least distance between two robots")
    center_m: Point = Field((0.0, 0.0), description="where the shape's centroid is put")


class DriveModel(Model):
    """What the robots' wheels make of a command; each part is off at 0, limits when left out."""

    max_accel_mps2: Positive | None = Field(None, description="limit of the change of v")
    max_turn_accel_radps2: Positive | None = Field(None, description="limit of the change of omega")
    wheel_step_mps: NotNegative = Field(0.0, description="wheel speeds are multiples of this")
    dead_zone_mps: NotNegative = Field(0.0, description="wheel speeds below this are 0")
    gain_error: Fraction = Field(
        0.0, description="each wheel is faster or slower by up to this share, drawn once"
    )
    track_m: Positive = Field(0.2, description="between the wheels, which the three above are about")
    slip: Fraction = Field(
        0.0, description="standard deviation of what v and omega gain or lose on the ground, as a share"
    )
    delay_s: Annotated[FiniteFloat, Field(ge=0, le=60)] = Field(
        0.0, description="from a command to its effect, in whole time steps, rounded up"
    )
    axis_offset_m: Coordinate = Field(
        0.0, description="how far ahead of the wheel axis the body's centre and the marker lie"
    )

    @property
    def has_wheels(self) -> bool:
        """Whether anything happens to single wheels."""
        return bool(self.wheel_step_mps or self.dead_zone_mps or self.gain_error)


class RobotsModel(Model):
    """The ground team: where it starts, or how it is scattered."""

    positions_m: list[Point] | None = Field(None, description="start positions on the ground")
    headings_deg: list[FiniteFloat] | None = Field(
        None, description="counter-clockwise from +x; random if left out"
    )
    scatter: ScatterModel | None = Field(None, description="a random start in place of positions_m")
    count: Annotated[int, Field(ge=2, le=10_000)] | None = Field(
        None, description="robots, where nothing else tells"
    )
    ids: list[MarkerId] | None = Field(None, description="marker ids; 0, 1, … if left out")
    max_speed_mps: Positive = Field(1.0, description="limit of |v|")
    max_turn_radps: Positive = Field(3.0, description="limit of |omega|")
    timeout_s: Positive = Field(
        0.5,
        description="a goal is forgotten after this; keep it above the time between two images",
    )
    body_radius_sides: NotNegative = Field(
        0.0, description="of the round body about the marker, in marker sides; robots are points at 0"
    )
    drive: DriveModel = DriveModel()


class MarkerModel(Model):
    """The markers on the robots."""

    dictionary: str = Field("4X4_50", description="OpenCV dictionary, without DICT_")
    side_m: Positive = Field(description="side of the black square")


class ObstacleModel(Model):
    """Something round that stands still, with a marker like a robot's at its middle."""

    id: MarkerId = Field(description="its marker, which is no robot's")
    position_m: Point
    heading_deg: FiniteFloat = Field(0.0, description="of its marker, counter-clockwise from +x")
    radius_sides: Positive = Field(1.0, description="of its body, in marker sides")


Method = Literal["similarity", "complex-laplacian", "bearing-only"]


class ControlModel(Model):
    """Gains of the robots' law."""

    method: Method = Field(
        "similarity", description="the units' law, or one from the literature that is told the truth"
    )
    gains: Literal["marker", "pixel"] = Field("marker", description="marker units, or the paper's pixels")
    k: Positive = Field(0.1, description="marker gains: speed a metre of goal, 1/s")
    k_v: Positive = Field(0.001, description="pixel gains: speed a pixel of goal, m/s/px")
    k_omega: Positive = Field(0.4, description="turn rate a radian, 1/s")
    b_th: NotNegative = Field(0.01, description="robots stop nearer to the goal: marker sides, or px")
    rectify: bool = Field(
        True, description="units learn from the markers what their cameras do, and take it off"
    )
    neighbors: Annotated[int, Field(ge=1)] = Field(3, description="nearest robots whose distances are sent")


class SelectionModel(Model):
    """Which robots a unit controls: all inside its safety radius, or by agreement along a tree of units."""

    kind: Literal["radius", "tree", "radius-then-tree"] = Field(
        "radius",
        description="free overlaps, or TC1-TC5 kept by the units' protocol, or that once V has stalled",
    )
    share: Literal["leverage", "nearest"] = Field(
        "leverage", description="tree: two neighbours share the pair that binds them best, or the nearest"
    )
    firm: Fraction = Field(
        0.2, description="tree: units fly to see a better pair while two agree slower than this, times k"
    )
    radius: Annotated[FiniteFloat, Field(gt=0, le=1.5)] = Field(
        0.85, description="safety radius, in halves of the image's shorter side"
    )
    hysteresis: NotNegative = Field(0.06, description="a robot leaves at radius (1 + hysteresis)")
    dwell_s: Positive = Field(2.0, description="least time between changes of topology")
    silence_s: Positive = Field(3.0, description="tree: a unit not heard for so long is dead")


class AutopilotModel(Model):
    """Limits that the units' autopilots keep."""

    min_height_m: Positive = 3.0
    max_height_m: Positive = 100.0
    max_speed_mps: Positive = 2.0
    max_climb_mps: Positive = 1.0
    max_yaw_rate_degps: Positive = 30.0

    @model_validator(mode="after")
    def _room(self) -> Self:
        if self.min_height_m >= self.max_height_m:
            raise ValueError("min_height_m must be below max_height_m")
        return self


class NetworkModel(Model):
    """What goes wrong with images and messages, from the seed."""

    frame_loss: Fraction = Field(0.0, description="share of images lost")
    message_loss: Fraction = Field(0.0, description="share of messages lost, for each receiver")
    range_m: Positive | None = Field(
        None, description="units hear one another up to this distance on the ground; no limit if left out"
    )
    delay_s: NotNegative = Field(
        0.0, description="largest random delay of a message, for each receiver; later ones may overtake"
    )
    repeats: Fraction = Field(0.0, description="share of messages that arrive twice")


class GoalModel(Model):
    """When a run counts as converged."""

    shape_error: Positive = Field(
        0.01, description="RMS distance to the best-fitting shape over its RMS radius"
    )
    hold_s: NotNegative = Field(5.0, description="how long it must stay under that, to the end")


class Scenario(Model):
    """A whole run: shape, robots, units, cameras, world."""

    name: str = Field(pattern=r"^\w[\w .-]*$", description="also the name of its output folder")
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 1
    duration_s: Annotated[FiniteFloat, Field(gt=0, le=86400)] = Field(description="simulated time")
    step_s: Annotated[FiniteFloat, Field(gt=0, le=1)] = Field(0.1, description="time step of the world")
    perception: Literal["rendered", "ideal", "noisy"] = "rendered"
    detector: str = Field(
        "tracking", description="marker detector, by name: `skyherd.vision.detector_names()`"
    )
    template: TemplateModel
    robots: RobotsModel
    marker: MarkerModel
    control: ControlModel = ControlModel()
    selection: SelectionModel = SelectionModel()
    roles: RolesModel = RolesModel()
    size: SizeModel = SizeModel()
    avoidance: AvoidanceModel = AvoidanceModel()
    units: list[UnitModel] = Field(min_length=1, max_length=256)
    autopilot: AutopilotModel = AutopilotModel()
    network: NetworkModel = NetworkModel()
    sensor: SensorModel = SensorModel()
    ground: GroundModel = GroundModel()
    occluders: list[OccluderModel] = Field(default=[], max_length=1000)
    obstacles: list[ObstacleModel] = Field(default=[], max_length=1000)
    goal: GoalModel = GoalModel()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for number, unit in enumerate(self.units):
            for complaint in self._complaints(unit):
                raise ValueError(f"unit {number}: {complaint}")
        return self

    @model_validator(mode="after")
    def _fit_for_baseline(self) -> Self:
        """Laws from the literature have one shape, fixed places in it, and robots that are points."""
        parts = {
            "roles.exchange": self.roles.exchange,
            "avoidance.on": self.avoidance.on,
            "template.then": self.template.then,
            "control.gains of pixels": self.control.gains == "pixel",
        }
        if self.control.method != "similarity" and (given := [name for name, on in parts.items() if on]):
            raise ValueError(f"control.method {self.control.method} knows no {given[0]}: leave it out")
        return self

    def _complaints(self, unit: UnitModel) -> Iterator[str]:
        low, high = self.autopilot.min_height_m, self.autopilot.max_height_m
        rate = unit.frame_rate_hz
        if not low <= unit.height_m <= high:
            yield f"height_m {unit.height_m:g} is outside the autopilot's {low:g} to {high:g} m"
        if rate * self.step_s > 1 + 1e-9:
            yield f"frame_rate_hz {rate:g} is more than one image a step_s of {self.step_s:g}"
        complaints = (unit.camera.lens_complaint(zoom) for zoom in unit.zooms())
        if complaint := next(filter(None, complaints), None):
            yield complaint
