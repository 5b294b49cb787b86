"""Scenario keys of an aerial unit: start, sway, flight and camera."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.camera_models import UnitCameraModel
from skyherd.datasets.configuration.fields import (
    MAX_ROBOTS,
    Angle,
    ClockDrift,
    ClockOffset,
    FrameRate,
    Height,
    Model,
    NotNegative,
    Point,
    Positive,
    Tilt,
    TurnRate,
    Zoom,
)
from skyherd.errors import InputError, join_errors

LENS_CHECKS = 5
"""Number of zooms at which a lens is checked, between the extremes. Chosen: the distortion varies smoothly
with the zoom, so that five show whether the lens folds the image."""


class FlightModel(Model):
    """Law of flight of a unit; lengths are in halves of the image's shorter side."""

    kind: Literal["follow", "perimeter", "hover", "keep-in-view"] = Field(
        "follow",
        description="law of flight: keep the robots that only this unit sees, follow a perimeter, stay, "
        "or keep its whole set in view",
    )
    desired_radius: Annotated[FiniteFloat, Field(ge=0.01, le=1.5)] = Field(
        0.7,
        description="wanted image distance of the farthest robot that is to be kept from the image's middle",
    )
    lateral_gain_mps: NotNegative = Field(
        1.0, description="m/s; horizontal speed for an error of half an image"
    )
    climb_gain_mps: NotNegative = Field(1.0, description="m/s; climb for an error of half an image")
    dead_band: NotNegative = Field(
        0.02, description="follow, keep-in-view: radius errors below this cause no climb"
    )
    zoom_gain_ps: NotNegative = Field(
        0.3, description="1/s; keep-in-view: relative change of the zoom for an error of half an image"
    )
    separation_sides: NotNegative = Field(
        6.0, description="marker sides; keep-in-view: least distance between two units' image centres"
    )
    min_side_px: NotNegative = Field(
        12.0, description="px; keep-in-view: neither climb nor zoom out once markers have only this side"
    )
    border_sides: NotNegative = Field(
        0.0, description="marker sides; keep-in-view: least distance of its robots from the image's border"
    )
    speed_mps: NotNegative = Field(0.1, description="m/s; perimeter: speed along it")
    yaw_rate_degps: TurnRate = Field(
        0.0, description="deg/s; perimeter, hover: turn rate, counter-clockwise from above"
    )


class SwayModel(Model):
    """Sway of a unit: filtered noise around the unit's `tilt_deg`, drawn from the scenario's seed."""

    tilt_deg: Annotated[FiniteFloat, Field(ge=0.001, le=15)] = Field(
        description="deg; root mean square of the tilt, both axes together"
    )
    period_s: Positive = Field(
        3.0,
        description="s; period in the middle of its spectrum, a bell as wide as a quarter of that frequency",
    )


class UnitModel(Model):
    """Aerial unit: its start, camera, flight and failures."""

    position_m: Point = Field(description="m; ground point (x, y) below it at the start")
    height_m: Height = Field(description="m; height above the ground at the start")
    yaw_deg: Angle = Field(
        0.0, description="deg; direction of the image's right on the ground, counter-clockwise from +x"
    )
    tilt_deg: tuple[Tilt, Tilt] = Field(
        (0.0, 0.0), description="deg; constant tilt about the camera's u and v axes"
    )
    sway: SwayModel | None = Field(None, description="sway; none if left out")
    camera: UnitCameraModel = Field(description="its camera; the controller gets only the image size")
    zoom: list[tuple[NotNegative, Zoom]] = Field(
        default=[(0.0, 1.0)],
        min_length=1,
        max_length=MAX_ROBOTS,
        description="points [time in s, factor on the focal length], linear between them",
    )
    zoom_range: tuple[Zoom, Zoom] = Field(
        (1.0, 1.0), description="least and greatest factor by which the unit itself may zoom"
    )
    outages: list[tuple[NotNegative, Positive]] = Field(
        [],
        max_length=1000,
        description="spans [from, to] in s in which it is dead: no images, no messages, and no memory after",
    )
    flight: FlightModel = Field(FlightModel(), description="law of flight")
    frame_rate_hz: FrameRate = Field(10.0, description="Hz; images a second; at most one a time step")
    latency_s: NotNegative = Field(
        0.0,
        description="s; delay from an image to the arrival of its goals and report; none for flight commands",
    )

    clock_offset_s: ClockOffset = Field(0.0, description="s; reading of its clock at the start of the run")
    clock_drift_ppm: ClockDrift = Field(
        0.0, description="ppm; drift of its clock against the world's; positive is fast"
    )

    @property
    def ideal(self) -> bool:
        """True if Property 1 holds for its camera: square pixels, a lens without distortion, and no tilt."""
        return self.sway is None and not any(self.tilt_deg) and self.camera.ideal

    def with_values(self, values: dict[str, Any]) -> Self:
        """Return the unit with other values by key, of the unit, its camera, or its constant zoom.

        Values of keys that neither the unit nor its camera has are ignored.
        """
        camera = {key: value for key, value in values.items() if key in UnitCameraModel.model_fields}
        own = {key: value for key, value in values.items() if key in type(self).model_fields}
        if "zoom" in own:
            own["zoom"] = [(0.0, own["zoom"])]
        return self.model_copy(update=own | {"camera": self.camera.model_copy(update=camera)})

    def zooms(self) -> list[float]:
        """Return the zooms, from the least to the greatest possible, at which the lens is checked."""
        scripted = [zoom for _, zoom in self.zoom]
        low, high = self.zoom_range
        return [float(z) for z in np.geomspace(min(scripted) * low, max(scripted) * high, LENS_CHECKS)]

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        problems = []
        times = [time for time, _ in self.zoom]
        if times != sorted(times):
            problems.append(InputError("zoom", f"times {times}", "times that ascend"))
        low, high = self.zoom_range
        if low > high:
            problems.append(InputError("zoom_range", f"[{low:g}, {high:g}]", "the smaller factor first"))
        for number, (start, end) in enumerate(self.outages):
            if start >= end:
                what = f"[{start:g}, {end:g}]"
                problems.append(InputError(f"outages.{number}", what, "an end after the start"))
        if problems:
            raise join_errors(problems)
        return self
