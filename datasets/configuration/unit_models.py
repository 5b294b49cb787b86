"""Keys of a scenario that say what an aerial unit is: where it hangs, how it sways and flies, how it sees."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.fields import Model, NotNegative, Point, Positive
from skyherd.datasets.configuration.scene_models import CameraModel

LENS_CHECKS = 5
"""Zooms that a lens is checked at."""


class FlightModel(Model):
    """How a unit flies; lengths are in halves of the image's shorter side."""

    kind: Literal["follow", "perimeter", "hover", "keep-in-view"] = "follow"
    desired_radius: Annotated[FiniteFloat, Field(gt=0, le=1.5)] = Field(
        0.7, description="image distance of the farthest robot to be kept"
    )
    lateral_gain_mps: NotNegative = Field(1.0, description="speed for half an image")
    climb_gain_mps: NotNegative = Field(1.0, description="climb for half an image")
    dead_band: NotNegative = Field(
        0.02, description="follow, keep-in-view: errors of radius below this do not climb"
    )
    zoom_gain_ps: NotNegative = Field(
        0.3, description="keep-in-view: relative change of zoom for half an image"
    )
    separation_sides: NotNegative = Field(
        6.0, description="keep-in-view: least distance between two units' image centres, in marker sides"
    )
    least_side_px: NotNegative = Field(
        12.0, description="keep-in-view: neither climb nor zoom out beyond where markers have this side"
    )
    speed_mps: NotNegative = Field(0.1, description="perimeter: speed along it")
    yaw_rate_degps: FiniteFloat = Field(
        0.0, description="perimeter, hover: turn, counter-clockwise from above"
    )


class SwayModel(Model):
    """How a unit sways: its tilt is filtered noise around the unit's `tilt_deg`, from the scenario's seed."""

    tilt_deg: Annotated[FiniteFloat, Field(gt=0, le=15)] = Field(
        description="root mean square of the tilt, of both axes together"
    )
    period_s: Positive = Field(
        3.0, description="middle of its spectrum, a bell whose width is a quarter of that frequency"
    )


class UnitModel(Model):
    """One aerial unit."""

    position_m: Point
    height_m: Positive
    yaw_deg: FiniteFloat = 0.0
    tilt_deg: tuple[
        Annotated[FiniteFloat, Field(ge=-45, le=45)], Annotated[FiniteFloat, Field(ge=-45, le=45)]
    ] = Field((0.0, 0.0), description="about the camera's u and v axes")
    sway: SwayModel | None = Field(None, description="left out: the unit hangs still")
    camera: CameraModel
    zoom: list[tuple[NotNegative, Positive]] = Field(
        default=[(0.0, 1.0)],
        min_length=1,
        description="[time_s, factor on the focal length] points, linear between",
    )
    zoom_range: tuple[Positive, Positive] = Field(
        (1.0, 1.0), description="least and largest factor that the unit itself may zoom by"
    )
    outages: list[tuple[NotNegative, Positive]] = Field(
        [],
        description="[from_s, to_s] in which the unit is dead: no images, no messages, no memory of before",
    )
    flight: FlightModel = FlightModel()
    frame_rate_hz: Positive = 10.0
    latency_s: NotNegative = Field(
        0.0, description="from an image to the arrival of its goals and report; not of its own flight command"
    )

    @property
    def ideal(self) -> bool:
        """Whether Property 1 holds for its camera: square pixels, a straight lens, looking straight down."""
        return self.sway is None and not any(self.tilt_deg) and self.camera.ideal

    def zooms(self) -> list[float]:
        """Zooms between the least and the greatest that may come, as a lens is checked at."""
        scripted = [zoom for _, zoom in self.zoom]
        low, high = self.zoom_range
        return [float(z) for z in np.geomspace(min(scripted) * low, max(scripted) * high, LENS_CHECKS)]

    @model_validator(mode="after")
    def _zoom_in_order(self) -> Self:
        times = [time for time, _ in self.zoom]
        if times != sorted(times):
            raise ValueError("zoom: times must ascend")
        if self.zoom_range[0] > self.zoom_range[1]:
            raise ValueError("zoom_range: the least factor comes first")
        if any(start >= end for start, end in self.outages):
            raise ValueError("outages: each must end after it begins")
        return self
