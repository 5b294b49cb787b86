"""Scenario keys of image formation: sensor, ground, and occluders of markers."""

from typing import Annotated, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.fields import (
    Angle,
    Coordinate,
    Model,
    NotNegative,
    Point,
    Positive,
    Share,
)
from skyherd.errors import InputError
from skyherd.markers.blur_model import total_sigma_px
from skyherd.render import (
    Clutter,
    Disc,
    Ground,
    Illumination,
    LensBlur,
    Mosaic,
    Processing,
    Quad,
    Sensor,
    Shutter,
)

Grey = Annotated[FiniteFloat, Field(ge=0, le=255)]
"""Grey level of 8 bits."""

PERIODS_M = {"concrete": 40.0, "tiles": 0.5, "image": 10.0}
"""Default of `tile_m` by kind of ground, m: the period of concrete, the side of a tile, the width of a
picture. Chosen: 2 cm per sample of concrete, and usual sizes of tiles and pictures."""


Blur = Annotated[FiniteFloat, Field(ge=0, le=10)]
"""Standard deviation of a lens's blur, px. Chosen: no marker is legible at the maximum."""

Exposure = Annotated[FiniteFloat, Field(ge=0, le=1)]
"""Exposure time, s. Chosen: longer than that of any video camera."""

Gain = Annotated[FiniteFloat, Field(ge=0.001, le=1000)]
"""Grey levels out for each grey level of light. Chosen: images are black or white at the ends."""

BlurLength = Annotated[FiniteFloat, Field(ge=0, le=20)]
"""Length of lens blur, px. Chosen: no marker is legible at the maximum."""

Aperture = Annotated[FiniteFloat, Field(ge=0, le=10)]
"""Diameter of a lens aperture, m. Chosen: at most that of the largest telescopes."""

BalanceGain = Annotated[FiniteFloat, Field(ge=1, le=4)]
"""White-balance gain of red or blue pixels, for `skyherd.render.Mosaic`."""

Gamma = Annotated[FiniteFloat, Field(ge=0.2, le=5)]
"""Gamma of a tone curve, for `skyherd.render.Processing`."""

Sharpening = Annotated[FiniteFloat, Field(ge=0, le=5)]
"""Amount of an unsharp mask, for `skyherd.render.Processing`."""

SharpeningRadius = Annotated[FiniteFloat, Field(ge=0.3, le=10)]
"""Standard deviation of an unsharp mask's blur, px, for `skyherd.render.Processing`."""

ConstantRateFactor = Annotated[int, Field(ge=0, le=51)]
"""Constant rate factor of x264. Defined by x264."""


class LensBlurModel(Model):
    """Non-Gaussian blur of the lens, in addition to `psf_px`; each part is off at 0."""

    disc_px: BlurLength = Field(0.0, description="px; radius of the disc that each point is seen as")
    coma_px: BlurLength = Field(0.0, description="px; length C of the coma, whose tail is 3 C long")
    coma_deg: Angle = Field(
        0.0, description="deg; direction of the coma's tail in the image, from right (0) towards down (90)"
    )
    aperture_m: Aperture = Field(
        0.0, description="m; diameter of the opening, for discs that grow with the distance from the focus"
    )
    focus_m: Positive = Field(10.0, description="m; distance along the optical axis that is in focus")

    def make(self) -> LensBlur:
        """Make the lens blur."""
        return LensBlur(
            disc_px=self.disc_px,
            coma_px=self.coma_px,
            coma_rad=float(np.radians(self.coma_deg)),
            aperture_m=self.aperture_m,
            focus_m=self.focus_m,
        )


class ProcessingModel(Model):
    """Image processing of a consumer camera after its sensor; each step is off by default."""

    demosaic: Literal["none", "bilinear", "edge-aware"] = Field(
        "none", description="a mosaic of colour filters after Bayer, and how colours between are interpolated"
    )
    red_gain: BalanceGain = Field(
        1.0, description="factor of white balance on red pixels of the mosaic, and on their noise"
    )
    blue_gain: BalanceGain = Field(1.0, description="the same of blue pixels")
    gamma: Gamma = Field(1.0, description="exponent 1 / gamma of the tone curve; 1 for a linear signal")
    s_curve: Share = Field(0.0, description="strength of the curve that makes middle grey steeper")
    denoise: Grey = Field(
        0.0, description="grey levels up to which a bilateral filter takes differences for noise"
    )
    sharpen: Sharpening = Field(0.0, description="amount of an unsharp mask")
    sharpen_px: SharpeningRadius = Field(1.0, description="px; standard deviation of the mask's blur")
    h264_crf: ConstantRateFactor | None = Field(
        None,
        description="constant rate factor, 0 (almost no loss) to 51, of an H.264 video that images go "
        "through after the JPEG; none if left out",
    )

    def make(self) -> Processing:
        """Make the processing."""
        return Processing(
            mosaic=Mosaic(self.demosaic, self.red_gain, self.blue_gain),
            **self.model_dump(exclude={"demosaic", "red_gain", "blue_gain"}),
        )


class SensorModel(Model):
    """Effects of the sensor on images: each is off at 0, `gain` at 1, `jpeg_quality` at None."""

    noise: Grey = Field(
        2.0, description="grey levels; standard deviation of the noise that does not depend on light"
    )
    shot: Share = Field(
        0.0, description="grey levels; variance of the shot noise for each grey level of signal"
    )
    gain: Gain = Field(1.0, description="grey levels out for each grey level of light")
    psf_px: Blur = Field(0.8, description="px; standard deviation of the lens's blur")
    exposure_s: Exposure = Field(0.0, description="s; exposure, which blurs what moves in the image")
    row_time_s: Annotated[FiniteFloat, Field(ge=0, le=0.01)] = Field(
        0.0, description="s; rolling shutter: time from one image row to the next"
    )
    vignetting: Share = Field(0.0, description="share of the light that the image's corners lack")
    gradient: Share = Field(0.0, description="relative growth of the light from one border to the other")
    gradient_deg: Angle = Field(
        0.0,
        description="deg; direction in the image in which the light grows, from right (0) towards down (90)",
    )
    shadow: Share = Field(0.0, description="share of the light that a cast shadow takes away")
    shadow_offset: Annotated[FiniteFloat, Field(ge=-100, le=100)] = Field(
        0.0,
        description="distance of the shadow's edge from the image's middle, in halves of the shorter side",
    )
    shadow_deg: Angle = Field(
        0.0, description="deg; direction from the edge into the shadow, from right (0) towards down (90)"
    )
    shadow_edge: NotNegative = Field(
        0.05, description="softness of the shadow's edge: standard deviation, in halves of the shorter side"
    )
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = Field(
        None, description="quality, 1 to 100, of a JPEG that images go through; none if left out"
    )
    lens_blur: LensBlurModel = Field(LensBlurModel(), description="defocus and coma")
    processing: ProcessingModel = Field(ProcessingModel(), description="image processing in the camera")

    def make(self, rng: np.random.Generator) -> Sensor:
        """Make the sensor; it draws its noise from `rng`.

        The renderer takes `psf_px`, `lens_blur` and the shutter separately.
        """
        return Sensor(
            noise=self.noise,
            rng=rng,
            shot=self.shot,
            gain=self.gain,
            illumination=self.make_illumination(),
            jpeg_quality=self.jpeg_quality,
            processing=self.processing.make(),
        )

    def make_illumination(self) -> Illumination:
        """Make the illumination: the relative light by place in the image."""
        return Illumination(
            vignetting=self.vignetting,
            gradient=self.gradient,
            gradient_rad=float(np.radians(self.gradient_deg)),
            shadow=self.shadow,
            shadow_offset=self.shadow_offset,
            shadow_rad=float(np.radians(self.shadow_deg)),
            shadow_edge=self.shadow_edge,
        )

    def make_shutter(self) -> Shutter:
        """Make the shutter: the exposure interval of each row."""
        return Shutter(exposure_s=self.exposure_s, row_time_s=self.row_time_s)


class GroundModel(Model):
    """Textured ground with clutter: dark quadrilaterals that are not markers."""

    kind: Literal["plain", "concrete", "tiles", "image"] = Field(
        "concrete",
        description="one grey level, noise with a 1/f spectrum, square tiles, or a picture repeated",
    )
    mean: Grey = Field(128.0, description="mean grey level; pictures have their own")
    contrast: Grey = Field(12.0, description="grey levels; standard deviation; for tiles, between them")
    tile_m: Positive | None = Field(
        None, description="m; period of concrete (40), side of a tile (0.5), or width of a picture (10)"
    )
    image: str | None = Field(
        None, description="picture file for the kind image, relative to the scenario's folder"
    )
    clutter_per_m2: NotNegative = Field(0.0, description="dark quadrilaterals on each square metre")
    clutter_side_m: tuple[Positive, Positive] = Field(
        (0.3, 1.0), description="m; least and greatest side of these quadrilaterals"
    )
    clutter_levels: tuple[Grey, Grey] = Field(
        (10.0, 60.0), description="least and greatest grey level of these quadrilaterals"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.kind == "image" and self.image is None:
            raise InputError("image", "missing", "a picture file, which the kind image needs")
        if self.kind != "image" and self.image is not None:
            raise InputError(
                "image", f"given with the kind {self.kind}", "leave it out, or set kind = 'image'"
            )
        for key, (low, high) in (
            ("clutter_side_m", self.clutter_side_m),
            ("clutter_levels", self.clutter_levels),
        ):
            if low > high:
                raise InputError(key, f"[{low:g}, {high:g}]", "the smaller number first")
        return self

    @property
    def period_m(self) -> float:
        """`tile_m`, or the default of the kind, m."""
        return self.tile_m or PERIODS_M.get(self.kind, PERIODS_M["concrete"])

    def make(self, seed: int, *, psf_px: float, image: npt.NDArray[np.uint8] | None = None) -> Ground:
        """Make the ground, with its clutter.

        Args:
            seed: seed of texture and clutter.
            psf_px: standard deviation of the lens's blur. Together with that of the pixel, it limits the
                texture's bandwidth.
            image: grey picture (height, width) from the file `image`, for the kind `image`.
        """
        clutter = None
        if self.clutter_per_m2:
            clutter = Clutter(
                seed=seed,
                density_per_m2=self.clutter_per_m2,
                side_m=self.clutter_side_m,
                levels=self.clutter_levels,
            )
        return Ground(
            seed,
            kind=self.kind,
            mean=self.mean,
            contrast=self.contrast,
            tile_m=self.period_m,
            sigma_px=total_sigma_px(psf_px),
            image=image,
            clutter=clutter,
        )


class OccluderModel(Model):
    """Opaque flat shape over markers: a disc, or a convex quadrilateral."""

    center_m: Point | None = Field(None, description="m; middle of a disc on the ground")
    radius_m: Positive | None = Field(None, description="m; radius of a disc")
    corners_m: list[tuple[Coordinate, Coordinate]] | None = Field(
        None,
        min_length=4,
        max_length=4,
        description="m; corners of a convex quadrilateral on the ground, in order",
    )
    level: Grey = Field(70.0, description="its grey level")

    @model_validator(mode="after")
    def _one(self) -> Self:
        disc = (self.center_m is not None) + (self.radius_m is not None)
        if disc != (0 if self.corners_m is not None else 2):
            given = [key for key in ("center_m", "radius_m", "corners_m") if getattr(self, key) is not None]
            what = f"{' and '.join(given)} given" if given else "no shape given"
            raise InputError("", what, "either center_m and radius_m, or corners_m")
        try:
            self.make()
        except InputError as error:
            raise InputError("", error.what, error.allowed) from None
        return self

    def make(self) -> Disc | Quad:
        """Make the disc or quadrilateral."""
        if self.center_m is not None and self.radius_m is not None:
            return Disc(self.center_m, self.radius_m, self.level)
        return Quad(np.array(self.corners_m), self.level)
