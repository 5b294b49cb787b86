"""The file that describes a set-up, `lab.toml`: shape, markers, cameras, robots, radio, limits."""

import ipaddress
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, FiniteFloat, ValidationError, model_validator

from skyherd.control import (
    AerialController,
    Hover,
    MarkerGains,
    Rectifier,
    RoleRule,
    SizeRule,
    TeamClock,
    Template,
    Wheels,
)
from skyherd.datasets import (
    FlightModel,
    Model,
    SelectionModel,
    SizeModel,
    built_in_names,
    built_in_text,
    first_error,
    parse_toml,
    put_value,
    read_toml_text,
    shape_points,
)
from skyherd.errors import DegenerateSetError, InputError
from skyherd.files.reading import is_regular
from skyherd.geometry import ComplexArray, to_complex
from skyherd.live.drivers.limits import SpeedLimits
from skyherd.live.peers import ClockLimits
from skyherd.live.robot_core import RobotCore, RobotLimits
from skyherd.live.unit_core import UnitCore
from skyherd.markers.dictionary import dictionary_names, dictionary_size
from skyherd.messages.checks import check_texts
from skyherd.sim.agents import REPORT_LIFETIME_S, REPORTS_MISSED, make_flight, make_selection
from skyherd.vision import detector_names

LABS = "skyherd.live.labs"
"""Package of the examples that `skyherd live show` prints."""

MOST_ROBOTS = 1000
"""Greatest number of robots of a lab. Chosen: each is a process and a radio peer."""

Seconds = Annotated[FiniteFloat, Field(ge=0.001, le=3600)]
"""A time span, s."""

Speed = Annotated[FiniteFloat, Field(gt=0, le=20)]
"""A limit on a speed or an acceleration of a robot. The range is chosen: beyond any robot indoors, so that a
slip of the decimal point is refused."""

Text = Annotated[str, Field(min_length=1, max_length=300)]
"""A name or an address."""


class LabShape(Model):
    """The shape to form: one of `shape` and `points`."""

    shape: str | None = Field(None, description="circle, grid, line, star, triangle, or word:SKY")
    points: list[tuple[FiniteFloat, FiniteFloat]] | None = Field(
        None, max_length=MOST_ROBOTS, description="a point (x right, y up) for each robot, in any unit"
    )
    size: SizeModel = Field(SizeModel(), description="how large the shape becomes")
    exchange: bool = Field(False, description="whether robots exchange their places for shorter ways")

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.shape is None) == (self.points is None):
            raise ValueError("give exactly one of shape and points")
        return self


class LabMarkers(Model):
    """The printed markers."""

    dictionary: str = Field("4X4_50", description="marker dictionary, as in `skyherd markers --help`")
    side_m: Annotated[FiniteFloat, Field(ge=0.001, le=10)] = Field(
        description="m; side of the black square, measured on the print"
    )


class LabCamera(Model):
    """One aerial unit: a camera that looks down on the robots, and the computer behind it."""

    address: Text = Field(
        description="/dev/video0, rtsp://…, http://…, tcp://…, udp://…, a video file, a folder of images, or "
        "module:factory"
    )
    detector: str = Field("tracking", description="one of `skyherd detect --help`")
    flight: FlightModel | None = Field(
        None, description="how it flies; left out for a camera that hangs still"
    )
    driver: Text | None = Field(None, description="where its flight commands go; left out: nowhere")


class LabRobot(Model):
    """One robot."""

    id: Annotated[int, Field(ge=0, lt=2**31)] = Field(description="its marker")
    driver: Text = Field("dry-run", description="where its wheel commands go")


class LabControl(Model):
    """The robots' law."""

    k: Annotated[FiniteFloat, Field(gt=0, le=100)] = Field(
        0.3, description="1/s; speed per metre to the goal"
    )
    k_omega: Annotated[FiniteFloat, Field(gt=0, le=100)] = Field(
        1.2, description="1/s; turn rate for each radian between heading and goal"
    )
    b_th: Annotated[FiniteFloat, Field(ge=0, le=100)] = Field(
        0.05, description="marker sides; robots nearer to their goal than this stop"
    )
    neighbors: Annotated[int, Field(ge=1, le=MOST_ROBOTS)] = Field(
        3, description="to how many nearest robots a unit sends each robot the distances"
    )
    rectify: bool = Field(True, description="learn tilt and lens of the cameras from the markers")
    axis_offset_m: Annotated[FiniteFloat, Field(ge=-1, le=1)] = Field(
        0.0, description="m; how far ahead of the wheel axis the marker's middle lies"
    )
    delay_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = Field(
        0.0, description="s; time from a command to its effect, if it is known"
    )


class LabLimits(Model):
    """What robots may do, and how long without news. They hold whatever comes in."""

    max_speed_mps: Speed = Field(0.2, description="m/s; limit on |v|")
    max_turn_radps: Speed = Field(1.5, description="rad/s; limit on |omega|")
    max_accel_mps2: Speed = Field(0.5, description="m/s²; limit on the growth of |v|")
    max_turn_accel_radps2: Speed = Field(4.0, description="rad/s²; limit on the growth of |omega|")
    goal_timeout_s: Seconds = Field(
        0.6, description="s; age of an image up to which the goal from it is followed"
    )
    unseen_s: Seconds = Field(1.0, description="s; a marker unseen for so long is outside all images")
    clock_offset_s: Seconds = Field(1.0, description="s; a clock that is farther off stops robots")
    clock_uncertainty_s: Seconds = Field(
        0.1, description="s; a clock that is known no better than this stops robots"
    )
    period_s: Annotated[FiniteFloat, Field(ge=0.005, le=0.5)] = Field(
        0.05, description="s; longest time between two commands to the wheels"
    )

    @model_validator(mode="after")
    def _more_than_a_period(self) -> Self:
        if self.goal_timeout_s < 2 * self.period_s:
            raise ValueError("goal_timeout_s must be at least two period_s")
        return self


class LabRadio(Model):
    """How the processes find each other."""

    listen: list[Text] = Field(
        ["tcp/127.0.0.1:7450"],
        max_length=20,
        description="where this machine listens, as Zenoh writes it; beyond loopback: tls/ADDRESS:PORT",
    )
    connect: list[Text] = Field(["tcp/127.0.0.1:7450"], max_length=100, description="where the others listen")
    authority: Text | None = Field(None, description="PEM file of the authority that signed the certificates")
    certificate: Text | None = Field(None, description="PEM file of this machine's certificate")
    key: Text | None = Field(None, description="PEM file of its private key")

    @property
    def is_loopback(self) -> bool:
        """Whether nothing outside this machine can take part."""
        return all(_is_loopback(place) for place in (*self.listen, *self.connect))

    @property
    def is_secured(self) -> bool:
        """Whether each place that is not on loopback is reached by TLS with client certificates."""
        files = self.authority and self.certificate and self.key
        return all(
            _is_loopback(place) or (place.startswith(("tls/", "quic/")) and bool(files))
            for place in (*self.listen, *self.connect)
        )

    def check(self, *, insecure: bool) -> None:
        """Refuse a radio that others could listen to or speak on, unless that is asked for.

        Raises:
            InputError: a place is neither on loopback nor reached by TLS with client certificates.
        """
        if not self.is_secured and not insecure:
            raise InputError(
                "radio",
                "reaches beyond this machine without TLS and client certificates",
                "tls/ addresses with authority, certificate and key; or --insecure, and anybody on the "
                "network can drive the robots",
            )


class LabRecording(Model):
    """What units record for viewers, beside all that they hear and do."""

    image_rate_hz: Annotated[FiniteFloat, Field(ge=0, le=60)] = Field(
        1.0, description="1/s; images with what was found in them; 0 for none"
    )
    image_width_px: Annotated[int, Field(ge=64, le=8192)] = Field(
        640, description="px; larger images are shrunk to this width"
    )


def _is_loopback(place: str) -> bool:
    """Whether a Zenoh locator, such as `tcp/127.0.0.1:7450`, is on loopback."""
    host = place.partition("/")[2].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class LabModel(Model):
    """A whole lab."""

    team: Annotated[str, Field(pattern=r"^\w[\w-]{0,39}$")] = Field(
        description="name of the team; messages of another one are refused"
    )
    shape: LabShape = Field(description="the shape to form")
    markers: LabMarkers = Field(description="the printed markers")
    cameras: list[LabCamera] = Field(min_length=1, max_length=64, description="the aerial units, 0, 1, …")
    robots: list[LabRobot] = Field(min_length=2, max_length=MOST_ROBOTS, description="the robots")
    control: LabControl = Field(LabControl(), description="the robots' law")
    selection: SelectionModel = Field(
        SelectionModel(radius=1.2), description="which robots each unit controls"
    )
    limits: LabLimits = Field(LabLimits(), description="what robots may do")
    radio: LabRadio = Field(LabRadio(), description="how the processes find each other")
    recording: LabRecording = Field(LabRecording(), description="what units record for viewers")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        ids = [robot.id for robot in self.robots]
        if twice := sorted({robot for robot in ids if ids.count(robot) > 1}):
            raise ValueError(f"robots: {twice[0]} is there twice")
        if self.shape.points is not None and len(self.shape.points) != len(ids):
            raise ValueError(f"shape.points: {len(self.shape.points)} points for {len(ids)} robots")
        if self.markers.dictionary not in dictionary_names():
            raise ValueError(
                f"markers.dictionary: no {self.markers.dictionary}; see `skyherd markers --help`"
            )
        if (largest := max(ids)) >= dictionary_size(self.markers.dictionary):
            raise ValueError(f"robots: {self.markers.dictionary} has no marker {largest}")
        for camera in self.cameras:
            if camera.detector not in detector_names():
                raise ValueError(f"cameras: no detector {camera.detector}; one of {detector_names()}")
        return self


@dataclass(frozen=True)
class Lab:
    """A checked lab.

    Attributes:
        model: the file, key by key.
        template: the shape, a point for each robot.
        folder: the folder to which files are relative.
    """

    model: LabModel
    template: Template
    folder: Path

    @property
    def ids(self) -> list[int]:
        """The robots' markers, ascending."""
        return sorted(robot.id for robot in self.model.robots)

    def robot(self, robot_id: int) -> LabRobot:
        """The entry of one robot.

        Raises:
            InputError: there is none with this marker.
        """
        for robot in self.model.robots:
            if robot.id == robot_id:
                return robot
        raise InputError("robot", f"no robot {robot_id} in this lab", f"one of {self.ids}")

    def camera(self, unit: int) -> LabCamera:
        """The entry of one unit.

        Raises:
            InputError: there is none of this number.
        """
        if not 0 <= unit < len(self.model.cameras):
            raise InputError("unit", f"no unit {unit} in this lab", f"0 to {len(self.model.cameras) - 1}")
        return self.model.cameras[unit]

    def make_controller(self, unit: int) -> AerialController:
        """The controller of one unit: the simulator's, with what the file says."""
        model = self.model
        flight = self.camera(unit).flight
        return AerialController(
            self.template,
            make_selection(model.selection),
            Hover(0.0) if flight is None else make_flight(flight, self.template),
            rectifier=Rectifier() if model.control.rectify else None,
            nearest=model.control.neighbors,
            report_lifetime_s=max(REPORT_LIFETIME_S, REPORTS_MISSED * model.limits.goal_timeout_s),
            roles=RoleRule(period_s=1.0, gain=0.05, classes=None) if model.shape.exchange else None,
            size=self._size(),
            clock=TeamClock(),
        )

    def make_unit(self, unit: int) -> UnitCore:
        """The computer of one unit.

        Raises:
            InputError: there is none of this number.
        """
        return UnitCore(
            unit,
            self.make_controller(unit),
            oldest_s=self.model.limits.goal_timeout_s,
            clock_limits=self.clock_limits,
        )

    def _size(self) -> SizeRule:
        """Bounds on the shape's size, in marker sides."""
        model = self.model.shape.size
        if model.unit_m is not None:
            sides = self.template.spacing_px * model.unit_m / self.model.markers.side_m
            return SizeRule(sides, sides)
        if model.spacing_sides is not None:
            return SizeRule(model.spacing_sides, model.spacing_sides)
        return SizeRule(model.least_spacing_sides)

    @property
    def clock_limits(self) -> ClockLimits:
        """When another process's clock is not trusted."""
        limits = self.model.limits
        return ClockLimits(limits.clock_offset_s, limits.clock_uncertainty_s)

    @property
    def speed_limits(self) -> SpeedLimits:
        """What a robot may be told at most."""
        limits = self.model.limits
        return SpeedLimits(
            limits.max_speed_mps,
            limits.max_turn_radps,
            limits.max_accel_mps2,
            limits.max_turn_accel_radps2,
        )

    def make_robot(self, robot_id: int) -> RobotCore:
        """The computer of one robot.

        Raises:
            InputError: there is no robot with this marker.
        """
        self.robot(robot_id)
        control, limits = self.model.control, self.model.limits
        law = MarkerGains(
            k=control.k, k_omega=control.k_omega, b_th=control.b_th, side_m=self.model.markers.side_m
        )
        return RobotCore(
            robot_id,
            list(range(len(self.model.cameras))),
            law,
            Wheels(limits.max_speed_mps, limits.max_turn_radps, control.axis_offset_m),
            RobotLimits(self.speed_limits, goal_timeout_s=limits.goal_timeout_s, unseen_s=limits.unseen_s),
            side_m=self.model.markers.side_m,
            delay_s=control.delay_s,
            clock_limits=self.clock_limits,
        )


def lab_names() -> list[str]:
    """Names of the examples."""
    return built_in_names(LABS)


def lab_text(name: str) -> str:
    """TOML text of an example.

    Raises:
        InputError: there is none of that name.
    """
    return built_in_text(LABS, name, "lab")


def load_lab(name_or_file: str, settings: Iterable[str] = ()) -> Lab:
    """Read and check a lab file, or an example by its name.

    Args:
        name_or_file: a TOML file, or the name of an example.
        settings: `key=value` texts put over it, such as `limits.max_speed_mps=0.1`.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    path = Path(name_or_file)
    is_file = path.suffix == ".toml" or is_regular(path)
    text = read_toml_text(path, "lab") if is_file else lab_text(name_or_file)
    where = str(path) if is_file else f"lab {name_or_file}"
    tree = parse_toml(text, where, "skyherd live show webcams")
    for setting in settings:
        check_texts("settings", [setting])
        key, sign, value = setting.partition("=")
        if not sign:
            raise InputError(f"--set {setting}", "no value", "key=value")
        try:
            put_value(tree, key, parse_toml(f"value = {value}", setting, "key=value")["value"], setting)
        except InputError:
            put_value(tree, key, value, setting)
    return make_lab(tree, where=where, folder=path.parent if is_file else Path())


def make_lab(tree: dict[str, Any], *, where: str = "lab", folder: Path | None = None) -> Lab:
    """Check a lab given as a tree of plain values.

    Raises:
        InputError: in one line, the key, the value, and what is allowed.
    """
    try:
        model = LabModel.model_validate(tree)
    except ValidationError as error:
        raise first_error(error, where, "lab", see="skyherd live schema") from None
    ids = [robot.id for robot in model.robots]
    try:
        points = _points(model, len(ids))
        template = Template(np.array(ids), points.conj())
    except DegenerateSetError as error:
        raise InputError(f"{where}: shape", str(error), "at least two distinct points") from None
    return Lab(model, template, folder or Path())


def _points(model: LabModel, count: int) -> ComplexArray:
    """The shape's points (N,), x + iy, in map sense, in the order of the file's robots."""
    if model.shape.points is not None:
        return np.array([complex(x, y) for x, y in model.shape.points])
    return to_complex(shape_points(str(model.shape.shape), count))
