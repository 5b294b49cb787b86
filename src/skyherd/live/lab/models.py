"""Keys of a lab file with their types and ranges. `skyherd.live.lab.checks` has the other checks."""

import ipaddress
from typing import Annotated

from pydantic import Field, FiniteFloat

from skyherd.datasets import (
    MAX_PLACES,
    AvoidanceModel,
    DictionaryName,
    FlightModel,
    Model,
    ObstacleMarkerModel,
    Point,
    RobotMarkerModel,
    SelectionModel,
    SizeModel,
    WheelsModel,
)
from skyherd.errors import InputError

MAX_ROBOTS = 1000
"""Largest number of robots of a lab. Chosen: each is a process and a radio peer."""

Seconds = Annotated[FiniteFloat, Field(ge=0.001, le=3600)]
"""A time span, s."""

Speed = Annotated[FiniteFloat, Field(gt=0, le=20)]
"""Limit of a robot's speed or acceleration, in SI units. The range is chosen: it exceeds any indoor robot,
and rejects a misplaced decimal point."""

Text = Annotated[str, Field(min_length=1, max_length=300)]
"""A name or an address."""

TEAM_PATTERN = r"^\w[\w-]{0,39}$"
"""Regular expression of a team's name, also in the JSON schema. *Chosen*: the name is part of the radio's
topics, where slashes and stars are special characters."""


class LabShape(Model):
    """Shape to form: exactly one of `shape` and `points`."""

    shape: str | None = Field(None, description="circle, grid, line, star, triangle, or word:SKY")
    points: list[Point] | None = Field(
        None, max_length=MAX_ROBOTS, description="a point (x right, y up) for each robot, in any unit"
    )
    size: SizeModel = Field(SizeModel(), description="size of the shape")
    exchange: bool = Field(False, description="whether robots exchange their places for shorter paths")


class LabMarkers(Model):
    """Printed markers."""

    dictionary: DictionaryName = Field(
        "4X4_50", description="marker dictionary, named as in `skyherd markers --help` or in OpenCV"
    )
    side_m: Annotated[FiniteFloat, Field(ge=0.001, le=10)] = Field(
        description="m; side of the black square, measured on the print"
    )
    on_robots: list[RobotMarkerModel] = Field(
        [],
        max_length=MAX_PLACES,
        description="several markers on each robot; if left out, one at its reference point with its id",
    )


class LabCamera(Model):
    """One aerial unit: a camera that looks down on the robots, and its computer."""

    address: Text = Field(
        description="/dev/video0, rtsp://…, http://…, tcp://…, udp://…, ros2://…, a video file, a "
        "folder of images, or module:factory"
    )
    detector: str = Field("tracking", description="one of `skyherd detect --help`")
    flight: FlightModel | None = Field(None, description="law of flight; left out for a fixed camera")
    driver: Text | None = Field(None, description="address of its flight commands; none if left out")
    calibration: Text | None = Field(
        None,
        description="file of its intrinsics, FILE or FILE#NAME, for poses of the markers in the recording; "
        "control does not use it",
    )


class LabRobot(Model):
    """One robot."""

    id: Annotated[int, Field(ge=0, lt=2**31)] = Field(description="its number, and its marker if it has one")
    driver: Text = Field("dry-run", description="address of its wheel commands")


class LabControl(Model):
    """Control law of the robots."""

    k: Annotated[FiniteFloat, Field(gt=0, le=100)] = Field(
        0.3, description="1/s; speed per metre to the goal"
    )
    k_omega: Annotated[FiniteFloat, Field(gt=0, le=100)] = Field(
        1.2, description="1/s; turn rate for each radian between heading and goal"
    )
    b_th: Annotated[FiniteFloat, Field(ge=0, le=100)] = Field(
        0.05, description="marker sides; robots nearer to their goal than this stop"
    )
    neighbors: Annotated[int, Field(ge=1, le=MAX_ROBOTS)] = Field(
        3, description="number of nearest robots to which a unit sends each robot the distances"
    )
    camera_check: bool = Field(
        True,
        description="whether units compare their images with the commanded motion, and send nothing while "
        "their camera seems to be frozen or to replay old images",
    )
    motion_check: bool = Field(
        True,
        description="whether a robot whose marker moves otherwise than its wheels were told is disarmed",
    )
    rectify: bool = Field(
        True, description="whether to estimate tilt and lens of the cameras from the markers"
    )
    axis_offset_m: Annotated[FiniteFloat, Field(ge=-1, le=1)] = Field(
        0.0, description="m; how far ahead of the wheel axis the marker's middle lies"
    )
    delay_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = Field(
        0.0, description="s; time from a command to its effect, if it is known"
    )


class LabLimits(Model):
    """Limits of the robots' motions, of the age of goals, and of clock errors. They hold for any message."""

    max_speed_mps: Speed = Field(0.2, description="m/s; limit on |v|")
    max_turn_radps: Speed = Field(1.5, description="rad/s; limit on |omega|")
    max_accel_mps2: Speed = Field(0.5, description="m/s²; limit on the growth of |v|")
    max_turn_accel_radps2: Speed = Field(4.0, description="rad/s²; limit on the growth of |omega|")
    goal_timeout_s: Seconds = Field(
        0.6, description="s; age of an image up to which the goal from it is followed"
    )
    unseen_s: Seconds = Field(
        1.0, description="s; a marker counts as outside all images this long after it was last seen"
    )
    clock_offset_s: Seconds = Field(1.0, description="s; a larger clock offset stops robots")
    clock_uncertainty_s: Seconds = Field(0.1, description="s; a larger uncertainty of a clock stops robots")
    period_s: Annotated[FiniteFloat, Field(ge=0.005, le=0.5)] = Field(
        0.05, description="s; longest time between two commands to the wheels"
    )


TLS_PROTOCOLS = ("tls/", "quic/")
"""Prefixes of Zenoh locators whose connections use TLS. Defined by Zenoh."""


class LabAvoidance(AvoidanceModel):
    """Collision avoidance among robots, and with obstacles."""

    body_radius_sides: Annotated[FiniteFloat, Field(ge=0, le=1000)] = Field(
        0.0, description="marker sides; radius of the robots' round bodies; above 0 if avoidance is on"
    )
    stamp_error_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = Field(
        0.05, description="s; how much older images may be than their time stamps, by exposure and encoding"
    )


class LabRadio(Model):
    """Zenoh endpoints and certificates by which the processes connect."""

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
        """True if all endpoints are on loopback, so that only this machine has access."""
        return all(_is_loopback(place) for place in (*self.listen, *self.connect))

    @property
    def is_secured(self) -> bool:
        """True if every endpoint is on loopback, or uses TLS with client certificates."""
        return all(
            _is_loopback(place) or (place.startswith(TLS_PROTOCOLS) and self.has_certificates)
            for place in (*self.listen, *self.connect)
        )

    @property
    def has_certificates(self) -> bool:
        """True if all three files for TLS are given."""
        return bool(self.authority and self.certificate and self.key)

    @property
    def plain_places(self) -> list[str]:
        """Endpoints to listen on or connect to without TLS."""
        return [place for place in (*self.listen, *self.connect) if not place.startswith(TLS_PROTOCOLS)]

    def check(self, *, insecure: bool) -> None:
        """Refuse a radio to which other machines have access without client certificates.

        Args:
            insecure: True allows it.

        Raises:
            InputError: an endpoint beyond loopback lacks TLS with client certificates; or an endpoint has no
                TLS although certificates are given; or some files for TLS are missing.
        """
        if insecure:
            return
        if not self.is_secured:
            raise InputError(
                "radio",
                "reaches beyond this machine without TLS and client certificates",
                "tls/ addresses with authority, certificate and key; or `insecure=True`, and anyone on the "
                "network can drive the robots",
            )
        if self.has_certificates and self.plain_places:
            raise InputError(
                "radio",
                f"{self.plain_places[0]} is not protected by the certificates",
                "tls/ addresses only in listen and connect; or no certificates; or `insecure=True`",
            )
        if any((self.authority, self.certificate, self.key)) and not self.has_certificates:
            raise InputError(
                "radio", "files for TLS are missing", "all of authority, certificate and key, or none"
            )


class LabRecording(Model):
    """Images that units record for viewers, in addition to messages and decisions."""

    image_rate_hz: Annotated[FiniteFloat, Field(ge=0, le=60)] = Field(
        1.0, description="1/s; rate of images with their detections; 0 for none"
    )
    image_width_px: Annotated[int, Field(ge=64, le=8192)] = Field(
        640, description="px; larger images are shrunk to this width"
    )


def _is_loopback(place: str) -> bool:
    """Return whether a Zenoh locator such as `tcp/127.0.0.1:7450` is on loopback."""
    host = place.partition("/")[2].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class LabModel(Model):
    """Content of a lab file."""

    team: str = Field(
        description="name of the team; messages of another one are refused",
        json_schema_extra={"pattern": TEAM_PATTERN},
    )
    shape: LabShape = Field(description="the shape to form")
    markers: LabMarkers = Field(description="the printed markers")
    cameras: list[LabCamera] = Field(min_length=1, max_length=64, description="the aerial units, 0, 1, …")
    robots: list[LabRobot] = Field(min_length=2, max_length=MAX_ROBOTS, description="the robots")
    control: LabControl = Field(LabControl(), description="the robots' law")
    selection: SelectionModel = Field(
        SelectionModel(radius=1.2), description="selection of the robots that each unit controls"
    )
    limits: LabLimits = Field(LabLimits(), description="limits of the robots")
    avoidance: LabAvoidance = Field(LabAvoidance(), description="how robots keep apart")
    obstacles: list[ObstacleMarkerModel] = Field(
        default=[], max_length=1000, description="markers of round bodies that stand still"
    )
    drive: WheelsModel = Field(
        WheelsModel(),
        description="errors of the wheels, and how fast they brake, which avoidance allows for; without "
        "max_accel_mps2 they brake as fast as limits.max_accel_mps2",
    )
    radio: LabRadio = Field(LabRadio(), description="radio between the processes")
    recording: LabRecording = Field(LabRecording(), description="recording of the units for viewers")
