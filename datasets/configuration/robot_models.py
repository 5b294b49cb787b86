"""Scenario keys of objects on the ground: robots, their wheels and markers, and obstacles."""

from typing import Annotated

from pydantic import Field, FiniteFloat

from skyherd.datasets.configuration.fields import (
    MAX_ROBOTS,
    Angle,
    ClockDrift,
    ClockOffset,
    DictionaryName,
    Fraction,
    Model,
    NotNegative,
    Offset,
    Point,
    Positive,
)
from skyherd.datasets.configuration.marker_layout import MAX_PLACES, RobotMarkerModel

MarkerId = Annotated[int, Field(ge=0, lt=2**31)]
"""Number of a marker in its dictionary. The completed scenario is checked against the dictionary's size."""


class ScatterModel(Model):
    """Random start: the template's points at `scale_m` metres a unit, each moved by up to `jitter_m`."""

    scale_m: Positive = Field(description="m; length on the ground of one unit of the template")
    jitter_m: NotNegative = Field(description="m; largest random displacement along x and along y")
    rotation_deg: Angle = Field(0.0, description="deg; turn of the shape, counter-clockwise")
    spacing_m: NotNegative = Field(0.0, description="m; least distance between two robots")
    center_m: Point = Field(
        (0.0, 0.0), description="m; point on the ground where the shape's centroid is put"
    )


class WheelsModel(Model):
    """Wheel errors and acceleration limit of the robots; errors are off at 0."""

    max_accel_mps2: Positive | None = Field(
        None, description="m/s²; limit on the change of the speed v; none if left out"
    )
    wheel_step_mps: NotNegative = Field(
        0.0, description="m/s; wheel speeds are multiples of this; 0: any speed"
    )
    dead_zone_mps: NotNegative = Field(0.0, description="m/s; smaller wheel speeds are 0")
    gain_error: Fraction = Field(
        0.0, description="largest relative speed error of a wheel, drawn once for each wheel"
    )
    track_m: Annotated[FiniteFloat, Field(ge=0.001, le=100)] = Field(
        0.2, description="m; distance between the wheels, for the three keys about wheels"
    )
    slip: Fraction = Field(
        0.0, description="standard deviation of the share of v and omega that the ground adds or takes"
    )

    @property
    def has_wheels(self) -> bool:
        """True if a setting acts on single wheels: steps, dead zone or gains."""
        return bool(self.wheel_step_mps or self.dead_zone_mps or self.gain_error)


class DriveModel(WheelsModel):
    """Response of the robots' drives to commands; errors and delays are off at 0."""

    max_turn_accel_radps2: Positive | None = Field(
        None, description="rad/s²; limit on the change of the turn rate omega; none if left out"
    )
    delay_s: Annotated[FiniteFloat, Field(ge=0, le=60)] = Field(
        0.0, description="s; time from a command to its effect, rounded up to whole time steps"
    )
    axis_offset_m: Offset = Field(
        0.0, description="m; how far ahead of the wheel axis the body's middle and the marker lie"
    )


class RobotsModel(Model):
    """The ground robots: their start and their limits."""

    positions_m: list[Point] | None = Field(
        None,
        max_length=MAX_ROBOTS,
        description="m; start positions (x, y) on the ground, one for each robot",
    )
    headings_deg: list[Angle] | None = Field(
        None,
        max_length=MAX_ROBOTS,
        description="deg; start headings, counter-clockwise from +x; random if left out",
    )
    scatter: ScatterModel | None = Field(None, description="a random start, instead of positions_m")
    count: Annotated[int, Field(ge=2, le=MAX_ROBOTS)] | None = Field(
        None, description="number of robots, where it does not follow from positions, ids or points"
    )
    ids: list[MarkerId] | None = Field(
        None,
        max_length=MAX_ROBOTS,
        description="number of each robot, and of its marker; 0, 1, … if left out",
    )
    max_speed_mps: Positive = Field(1.0, description="m/s; limit on the speed |v|")
    clock_offset_s: ClockOffset = Field(
        0.0, description="s; largest offset of the robots' clocks, either way, drawn once for each"
    )
    clock_drift_ppm: ClockDrift = Field(
        0.0, description="ppm; largest drift of the robots' clocks, either way, drawn once for each"
    )
    max_turn_radps: Positive = Field(3.0, description="rad/s; limit on the turn rate |omega|")
    timeout_s: Positive = Field(
        0.5,
        description="s; a robot forgets its goal after this; keep it above the time between two images",
    )
    markers: list[RobotMarkerModel] = Field(
        [],
        max_length=MAX_PLACES,
        description="several markers on each robot; if left out, one at its reference point with its id",
    )
    body_radius_sides: NotNegative = Field(
        0.0, description="marker sides; radius of the round body about the marker; 0: robots are points"
    )
    drive: DriveModel = Field(DriveModel(), description="response of the wheels to a command")


class MarkerModel(Model):
    """The markers on robots and obstacles."""

    dictionary: DictionaryName = Field(
        "4X4_50", description="marker dictionary, named as in `skyherd markers --help` or in OpenCV"
    )
    side_m: Annotated[FiniteFloat, Field(ge=0.001, le=1000)] = Field(
        description="m; side of the black square"
    )


class ObstacleMarkerModel(Model):
    """Marker of a round obstacle, at the centre of the obstacle."""

    id: MarkerId = Field(description="its marker, which no robot has")
    radius_sides: Positive = Field(1.0, description="marker sides; radius of its body")


class ObstacleModel(ObstacleMarkerModel):
    """Static round body with a marker at its centre."""

    position_m: Point = Field(description="m; its place (x, y) on the ground")
    heading_deg: Angle = Field(0.0, description="deg; heading of its marker, counter-clockwise from +x")
