"""Keys of a scenario that say how its images come about: cameras, sensor, ground, what covers markers."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.cameras import CAMERAS
from skyherd.datasets.configuration.fields import Coordinate, Model, NotNegative, Point, Positive
from skyherd.errors import InputError
from skyherd.render import Camera, Disc, Distortion, Equidistant, Illumination, Quad, Sensor, Shutter

Coefficient = Annotated[FiniteFloat, Field(ge=-10, le=10)]
Share = Annotated[FiniteFloat, Field(ge=0, le=1)]
Grey = Annotated[FiniteFloat, Field(ge=0, le=255)]


class DistortionModel(Model):
    """A lens after Brown and Conrady, as OpenCV names it; none by default."""

    k1: Coefficient = Field(0.0, description="radial, of the square of the distance from the axis")
    k2: Coefficient = Field(0.0, description="radial, of its fourth power")
    k3: Coefficient = Field(0.0, description="radial, of its sixth power")
    p1: Coefficient = Field(0.0, description="tangential, along v")
    p2: Coefficient = Field(0.0, description="tangential, along u")


class CameraModel(Model):
    """A camera; the controller is told nothing of this but the image's size."""

    preset: str | None = Field(
        None, description=f"a camera to begin with, which the other keys change: {', '.join(CAMERAS)}"
    )
    size_px: tuple[Annotated[int, Field(ge=32, le=8192)], Annotated[int, Field(ge=32, le=8192)]] = (800, 800)
    focal_px: Positive | None = Field(None, description="focal length; or half_angle_deg")
    half_angle_deg: Annotated[FiniteFloat, Field(gt=0, lt=85)] | None = Field(
        None, description="half the field of view across the image's shorter side"
    )
    principal_point_px: Point | None = Field(None, description="the image's centre if left out")
    aspect: Positive = Field(1.0, description="focal length along v over along u")
    skew: FiniteFloat = Field(0.0, description="of the pixel axes")
    mirrored: bool = Field(False, description="the stream is flipped left to right")
    lens: Literal["perspective", "equidistant"] = Field(
        "perspective", description="equidistant: a fisheye that sees a ray f times its angle from the centre"
    )
    distortion: DistortionModel = Field(DistortionModel(), description="of a perspective lens")
    zoom_k1: Coefficient = Field(0.0, description="what each doubling of the zoom adds to distortion.k1")

    @model_validator(mode="before")
    @classmethod
    def _begin_with_preset(cls, given: Any) -> Any:
        if not isinstance(given, dict) or given.get("preset") is None:
            return given
        if given["preset"] not in CAMERAS:
            raise ValueError(f"no preset {given['preset']!r}; one of {', '.join(CAMERAS)}")
        preset = dict(CAMERAS[given["preset"]])
        if given.get("focal_px") is not None or given.get("half_angle_deg") is not None:
            preset.pop("half_angle_deg")
        return preset | given

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.focal_px is None) == (self.half_angle_deg is None):
            raise ValueError("give exactly one of focal_px and half_angle_deg")
        if self.lens == "equidistant" and (self.zoom_k1 or self.distortion != DistortionModel()):
            raise ValueError(
                "distortion and zoom_k1 are of perspective lenses: leave them out, or lens = 'equidistant'"
            )
        return self

    @property
    def ideal(self) -> bool:
        """Whether it has square pixels, and a lens that does not bend."""
        return (self.aspect, self.skew) == (1.0, 0.0) and not self.make().distortion

    @property
    def focal_length_px(self) -> float:
        """Focal length along u."""
        if self.focal_px is not None:
            return self.focal_px
        half_angle = float(np.radians(self.half_angle_deg or 0.0))
        return min(self.size_px) / 2 / (half_angle if self.lens == "equidistant" else np.tan(half_angle))

    def make(self, zoom: float = 1.0) -> Camera:
        """The camera described, its focal length multiplied by a zoom."""
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

    def lens_complaint(self, zoom: float) -> str | None:
        """Why the lens makes no image at a zoom, if it makes none."""
        try:
            self.make(zoom)
        except InputError as error:
            key = "distortion" if self.lens == "perspective" else "lens"
            return f"camera.{key}: {error.what}; {error.allowed}"
        return None


class SensorModel(Model):
    """What the cameras' images suffer; each is off at 0, gain at 1, jpeg_quality when left out."""

    noise: NotNegative = Field(2.0, description="standard deviation, grey levels")
    shot: Share = Field(0.0, description="variance of shot noise a grey level of signal, grey levels")
    gain: Positive = Field(1.0, description="grey levels out for one in")
    psf_px: Annotated[FiniteFloat, Field(ge=0, le=10)] = Field(
        0.8, description="standard deviation of the blur"
    )
    exposure_s: Annotated[FiniteFloat, Field(ge=0, le=1)] = Field(
        0.0, description="blurs what moves in the image"
    )
    row_time_s: Annotated[FiniteFloat, Field(ge=0, le=0.01)] = Field(
        0.0, description="rolling shutter: time from one row to the next"
    )
    vignetting: Share = Field(0.0, description="share of the light that the image's corners lack")
    gradient: Share = Field(0.0, description="share by which light grows from border to border")
    gradient_deg: FiniteFloat = Field(0.0, description="its direction in the image, from right to down")
    shadow: Share = Field(0.0, description="share of the light that a cast shadow takes away")
    shadow_offset: FiniteFloat = Field(
        0.0, description="its edge from the image's middle, in halves of the shorter side"
    )
    shadow_deg: FiniteFloat = Field(0.0, description="on which side of its edge it lies, from right to down")
    shadow_edge: NotNegative = Field(
        0.05, description="softness of its edge, standard deviation, in halves of the shorter side"
    )
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = Field(
        None, description="images go through a JPEG"
    )

    def make(self, rng: np.random.Generator) -> Sensor:
        """The sensor, its noise drawn from `rng`; `psf_px` and `shutter` are the renderer's."""
        return Sensor(
            self.noise,
            rng,
            shot=self.shot,
            gain=self.gain,
            illumination=self.illumination(),
            jpeg_quality=self.jpeg_quality,
        )

    def illumination(self) -> Illumination:
        """Where how much light arrives."""
        return Illumination(
            vignetting=self.vignetting,
            gradient=self.gradient,
            gradient_rad=float(np.radians(self.gradient_deg)),
            shadow=self.shadow,
            shadow_offset=self.shadow_offset,
            shadow_rad=float(np.radians(self.shadow_deg)),
            shadow_edge=self.shadow_edge,
        )

    def shutter(self) -> Shutter:
        """When light is gathered."""
        return Shutter(self.exposure_s, self.row_time_s)


class GroundModel(Model):
    """The textured ground and dark quadrilaterals on it."""

    kind: Literal["plain", "concrete", "tiles", "image"] = "concrete"
    mean: Grey = 128.0
    contrast: NotNegative = Field(12.0, description="standard deviation, grey levels; of tiles, between them")
    tile_m: Positive | None = Field(
        None, description="period of concrete (40 m), side of a tile (0.5 m), width of an image (10 m)"
    )
    image: str | None = Field(None, description="a picture file, beside the scenario, for the kind image")
    clutter_per_m2: NotNegative = Field(0.0, description="dark quadrilaterals on a square metre")
    clutter_side_m: tuple[Positive, Positive] = Field((0.3, 1.0), description="their least and greatest side")
    clutter_levels: tuple[Grey, Grey] = Field((10.0, 60.0), description="their least and greatest grey level")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.kind == "image") != (self.image is not None):
            raise ValueError("give image, a picture file, with the kind image, and with no other")
        for low, high in (self.clutter_side_m, self.clutter_levels):
            if low > high:
                raise ValueError("clutter_side_m and clutter_levels go from least to greatest")
        return self

    @property
    def period_m(self) -> float:
        """`tile_m`, or what the kind has where it is left out."""
        return self.tile_m or {"tiles": 0.5, "image": 10.0}.get(self.kind, 40.0)


class OccluderModel(Model):
    """Something opaque and flat that lies over markers: a disc, or a convex quadrilateral."""

    center_m: Point | None = Field(None, description="of a disc")
    radius_m: Positive | None = Field(None, description="of a disc")
    corners_m: list[tuple[Coordinate, Coordinate]] | None = Field(
        None, min_length=4, max_length=4, description="of a quadrilateral, in order"
    )
    level: Grey = Field(70.0, description="grey level")

    @model_validator(mode="after")
    def _one(self) -> Self:
        disc = (self.center_m is not None) + (self.radius_m is not None)
        if disc != (0 if self.corners_m is not None else 2):
            raise ValueError("give either center_m and radius_m, or corners_m")
        try:
            self.make()
        except InputError as error:
            raise ValueError(f"{error.what}; {error.allowed}") from None
        return self

    def make(self) -> Disc | Quad:
        """The occluder described."""
        if self.center_m is not None and self.radius_m is not None:
            return Disc(self.center_m, self.radius_m, self.level)
        return Quad(np.array(self.corners_m), self.level)
