"""Scenario keys of a camera: intrinsics and lens."""

import re
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.cameras import CAMERAS
from skyherd.datasets.configuration.fields import Model, NotNegative, Point, Positive
from skyherd.datasets.configuration.validation import shown
from skyherd.errors import InputError
from skyherd.render import Camera, Distortion, Equidistant
from skyherd.text import one_of

LENS_VALUES = re.compile(r"^\w+\([^)]*\)")
"""Pattern of a lens with its coefficients, at the start of error messages about it."""

Coefficient = Annotated[FiniteFloat, Field(ge=-10, le=10)]
"""Coefficient of a lens. The range is chosen: real lenses stay below 1."""


Aspect = Annotated[FiniteFloat, Field(ge=0.05, le=20)]
"""Focal length along v over that along u. The range is chosen: beyond any stretched image."""


class DistortionModel(Model):
    """Distortion of a perspective lens after Brown and Conrady, named as in OpenCV; none by default."""

    k1: Coefficient = Field(
        0.0, description="radial coefficient of r², r being the distance from the axis in focal lengths"
    )
    k2: Coefficient = Field(0.0, description="radial coefficient of r⁴")
    k3: Coefficient = Field(0.0, description="radial coefficient of r⁶")
    p1: Coefficient = Field(0.0, description="tangential coefficient, along v")
    p2: Coefficient = Field(0.0, description="tangential coefficient, along u")


class CameraModel(Model):
    """Camera: image size, intrinsics and lens. The controller gets only the image size."""

    preset: str | None = Field(
        None, description=f"preset camera, whose values the other keys replace: {', '.join(CAMERAS)}"
    )
    size_px: tuple[Annotated[int, Field(ge=32, le=8192)], Annotated[int, Field(ge=32, le=8192)]] = Field(
        (800, 800), description="px; width and height of the image"
    )
    focal_px: Annotated[FiniteFloat, Field(ge=1, le=1_000_000)] | None = Field(
        None, description="px; focal length along u; give this or half_angle_deg"
    )
    half_angle_deg: Annotated[FiniteFloat, Field(ge=0.01, lt=85)] | None = Field(
        None, description="deg; half the field of view across the image's shorter side"
    )
    principal_point_px: Point | None = Field(
        None, description="px; where the optical axis meets the image; the image's centre if left out"
    )
    aspect: Aspect = Field(1.0, description="focal length along v over that along u; 1 for square pixels")
    skew: Annotated[FiniteFloat, Field(ge=-2, le=2)] = Field(
        0.0,
        description="change of u with v along the sensor, as a share of the focal length; 0 for right angles",
    )
    mirrored: bool = Field(
        False, description="whether the stream is flipped left to right, as behind a mirror"
    )
    lens: Literal["perspective", "equidistant"] = Field(
        "perspective",
        description="perspective, or equidistant: a fisheye that sees a ray at its angle (rad) times "
        "focal_px",
    )
    distortion: DistortionModel = Field(DistortionModel(), description="coefficients of a perspective lens")
    zoom_k1: Coefficient = Field(
        0.0,
        description="change of distortion.k1 for each doubling of the zoom; 0 for a constant lens",
    )

    @model_validator(mode="before")
    @classmethod
    def _begin_with_preset(cls, given: Any) -> Any:
        if not isinstance(given, dict) or given.get("preset") is None:
            return given
        if not isinstance(given["preset"], str):
            return given  # refused as no text
        if given["preset"] not in CAMERAS:
            raise InputError(
                "preset", f"no preset {shown(given['preset'])}", one_of(str(given["preset"]), CAMERAS)
            )
        preset = dict(CAMERAS[given["preset"]])
        if given.get("focal_px") is not None or given.get("half_angle_deg") is not None:
            preset.pop("half_angle_deg")
        return preset | given

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.focal_px is None) == (self.half_angle_deg is None):
            what = (
                "neither focal_px nor half_angle_deg"
                if self.focal_px is None
                else "focal_px and half_angle_deg"
            )
            raise InputError("", f"{what} given", "exactly one of the two")
        if self.lens == "equidistant" and (self.zoom_k1 or self.distortion != DistortionModel()):
            key = "zoom_k1" if self.zoom_k1 else "distortion"
            raise InputError(
                key, "given with lens = 'equidistant'", "leave it out, or set lens = 'perspective'"
            )
        return self

    @property
    def ideal(self) -> bool:
        """True if Property 1 can hold: square pixels, and a lens that keeps lines straight."""
        return (self.aspect, self.skew) == (1.0, 0.0) and not self.make().distortion

    @property
    def focal_length_px(self) -> float:
        """Focal length along u, px, from `focal_px` or `half_angle_deg`."""
        if self.focal_px is not None:
            return self.focal_px
        half_angle = float(np.radians(self.half_angle_deg or 0.0))
        return min(self.size_px) / 2 / (half_angle if self.lens == "equidistant" else np.tan(half_angle))

    def make(self, zoom: float = 1.0) -> Camera:
        """Make the camera, with its focal length multiplied by a zoom factor.

        Raises:
            InputError: the lens has no valid image of this size.
        """
        return Camera(
            size_px=self.size_px,
            focal_px=self.focal_length_px * zoom,
            principal_point_px=self.principal_point_px,
            aspect=self.aspect,
            skew=self.skew,
            mirrored=self.mirrored,
            distortion=self._make_lens().at(zoom) if zoom != 1 else self._make_lens(),
        )

    def _make_lens(self) -> Distortion | Equidistant:
        if self.lens == "equidistant":
            return Equidistant()
        return Distortion(**self.distortion.model_dump(), zoom_k1=self.zoom_k1)

    def lens_problem(self, zoom: float) -> InputError | None:
        """Return the error, at its key, of a lens without a valid image at a zoom; None if it is valid."""
        try:
            self.make(zoom)
        except InputError as error:
            key = "distortion" if self.lens == "perspective" else "lens"
            return InputError(key, LENS_VALUES.sub("the lens", error.what), error.allowed)
        return None


class CameraFaultModel(Model):
    """Span in which a camera sends old images with fresh time stamps."""

    kind: Literal["freeze", "delay", "replay"] = Field(
        description="repeat the image of start_s; show the images of by_s ago; or repeat the clip of by_s "
        "before start_s"
    )
    start_s: NotNegative = Field(description="s; start of the fault")
    end_s: Positive = Field(description="s; end of the fault; after it images are current again")
    by_s: Positive = Field(
        2.0, description="s; delay: age of the images; replay: length of the repeated clip"
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.start_s >= self.end_s:
            raise InputError("end_s", f"{self.end_s:g}, with start_s {self.start_s:g}", "more than start_s")
        return self

    def shown_s(self, time_s: float) -> float:
        """Return the time of the image that is shown during the fault."""
        if self.kind == "freeze":
            return self.start_s
        if self.kind == "delay":
            return time_s - self.by_s
        return self.start_s - self.by_s + (time_s - self.start_s) % self.by_s

    def oldest_s(self, time_s: float) -> float:
        """Return the time of the oldest image that is shown at a time or later, before the end."""
        if self.kind == "delay":
            return max(self.start_s, time_s) - self.by_s
        return self.start_s - (self.by_s if self.kind == "replay" else 0.0)


class UnitCameraModel(CameraModel):
    """Camera of a unit, with its faults."""

    faults: tuple[CameraFaultModel, ...] = Field(
        (), max_length=100, description="spans in which its images are old, with fresh time stamps"
    )
