"""Scenario key `interventions`: changes of a running simulation, each at its time.

An intervention is a frozen value of one of several kinds, told apart by its key `kind`. The loop applies it
between two steps (`skyherd.sim.interventions`). Keys that are left out keep their values.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from skyherd.datasets.configuration.camera_models import Aspect, DistortionModel
from skyherd.datasets.configuration.fields import (
    Angle,
    Fraction,
    Height,
    Model,
    NotNegative,
    Point,
    Positive,
    Share,
    Tilt,
    Zoom,
)
from skyherd.datasets.configuration.robot_models import MarkerId
from skyherd.datasets.configuration.scene_models import Blur, Exposure, Gain, Grey
from skyherd.datasets.configuration.template_models import ShapeModel
from skyherd.datasets.configuration.validation import check_tree
from skyherd.errors import InputError

MAX_UNITS = 256
"""Maximum number of aerial units. Chosen: ten times the largest number in `benchmarks/scale.py`."""

UnitNumber = Annotated[int, Field(ge=0, lt=MAX_UNITS)]
"""Number of an aerial unit, in the order of the file."""

NOT_CHANGES = frozenset({"kind", "at_s", "unit", "robot", "marker"})
"""Keys of interventions that say when and where something changes."""


class InterventionModel(Model):
    """Base of all interventions."""

    at_s: NotNegative = Field(description="s; time; the first step at or after it has the change")

    @property
    def changes(self) -> dict[str, Any]:
        """The given values by key, without kind, time, and the unit or robot."""
        given = ((key, getattr(self, key)) for key in type(self).model_fields if key not in NOT_CHANGES)
        return {key: value for key, value in given if value is not None}

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        keys = [key for key in type(self).model_fields if key not in NOT_CHANGES]
        if keys and not self.changes:
            raise InputError("", "nothing to change", f"at least one of {', '.join(keys)}")
        return self


class UnitIntervention(InterventionModel):
    """An aerial unit is moved, turned or tilted; its flight law goes on from there."""

    kind: Literal["unit"]
    unit: UnitNumber = Field(description="number of the aerial unit, from 0")
    position_m: Point | None = Field(None, description="m; ground point (x, y) below it")
    height_m: Height | None = Field(
        None, description="m; height above the ground, within the autopilot's limits"
    )
    yaw_deg: Angle | None = Field(None, description="deg; direction of the image's right, as `units.yaw_deg`")
    tilt_deg: tuple[Tilt, Tilt] | None = Field(
        None, description="deg; constant tilt from now on, as `units.tilt_deg`"
    )


class CameraIntervention(InterventionModel):
    """A camera changes; blur, noise, exposure and gain act on rendered images only."""

    kind: Literal["camera"]
    unit: UnitNumber = Field(description="number of the aerial unit, from 0")
    zoom: Zoom | None = Field(
        None, description="factor on the focal length from now on, instead of `units.zoom`"
    )
    distortion: DistortionModel | None = Field(None, description="coefficients of a perspective lens")
    aspect: Aspect | None = Field(None, description="focal length along v over that along u")
    psf_px: Blur | None = Field(None, description="px; standard deviation of the lens's blur")
    noise: Grey | None = Field(None, description="grey levels; standard deviation of the noise")
    exposure_s: Exposure | None = Field(None, description="s; exposure, which blurs what moves in the image")
    gain: Gain | None = Field(None, description="grey levels out for each grey level of light")
    frame_loss: Share | None = Field(None, description="share of this camera's images that are lost")


class RobotIntervention(InterventionModel):
    """A robot is moved or turned by hand."""

    kind: Literal["robot"]
    robot: MarkerId = Field(description="marker of the robot")
    position_m: Point | None = Field(None, description="m; centre of its marker on the ground")
    heading_deg: Angle | None = Field(None, description="deg; heading, counter-clockwise from +x")


class CoverIntervention(InterventionModel):
    """A marker is covered by a card of one grey level that moves with it, or uncovered."""

    kind: Literal["cover"]
    marker: MarkerId = Field(description="marker on a robot or an obstacle")
    covered: bool = Field(True, description="whether it is covered from now on")


class LifeIntervention(InterventionModel):
    """A unit fails, or returns without memory, as in `units.outages`."""

    kind: Literal["kill", "revive"]
    unit: UnitNumber = Field(description="number of the aerial unit, from 0")


class NetworkIntervention(InterventionModel):
    """The radio changes. The team's own settings stay those of the start."""

    kind: Literal["network"]
    message_loss: Fraction | None = Field(None, description="share of messages that are lost")
    delay_s: NotNegative | None = Field(None, description="s; largest delay of a message")


class ControlIntervention(InterventionModel):
    """The robots get other gains."""

    kind: Literal["control"]
    k: Positive | None = Field(None, description="1/s; with marker gains: speed for each metre to the goal")
    k_v: Positive | None = Field(
        None, description="m/s/px; with pixel gains: speed for each pixel to the goal"
    )
    k_omega: Positive | None = Field(None, description="1/s; turn rate for each radian to the goal")
    b_th: NotNegative | None = Field(
        None, description="marker sides, or px with pixel gains; robots nearer stop"
    )


class TemplateIntervention(InterventionModel, ShapeModel):
    """The team gets another shape, as in `template.then`; `at_s` is above 0."""

    kind: Literal["template"]


Intervention = Annotated[
    UnitIntervention
    | CameraIntervention
    | RobotIntervention
    | CoverIntervention
    | LifeIntervention
    | NetworkIntervention
    | ControlIntervention
    | TemplateIntervention,
    Field(discriminator="kind"),
]
"""Change of a running simulation."""


class InterventionList(Model):
    """A list of interventions, as a part of a scenario or from another source."""

    interventions: list[Intervention]


def read_interventions(tables: Any) -> tuple[Intervention, ...]:
    """Return interventions from a list of plain tables, as in TOML or in a recording.

    Raises:
        InputError: a table is not a valid intervention; one line for each problem.
    """
    tree = {"interventions": list(tables) if isinstance(tables, tuple) else tables}
    read = check_tree(InterventionList, tree, "read_interventions", see="skyherd scenario schema")
    return tuple(read.interventions)
