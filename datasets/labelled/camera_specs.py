"""Cameras of a labelled image set: lenses, sensors, and image processing."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from skyherd.datasets.configuration.camera_models import Coefficient
from skyherd.datasets.configuration.fields import Model, Share
from skyherd.datasets.configuration.scene_models import (
    BalanceGain,
    BlurLength,
    ConstantRateFactor,
    Gamma,
    Grey,
    Sharpening,
    SharpeningRadius,
)
from skyherd.datasets.labelled.ranges import Span

Blur = Annotated[FiniteFloat, Field(ge=0.3, le=5)]
"""Standard deviation of a lens's blur, px. Chosen: from sharp lenses to images out of focus."""


class DistortionSpec(Model):
    """Coefficients of the lenses after Brown and Conrady, named as in OpenCV."""

    k1: Span[Coefficient] = Field((0.0, 0.0), description="radial coefficient of r²")
    k2: Span[Coefficient] = Field((0.0, 0.0), description="radial coefficient of r⁴")
    k3: Span[Coefficient] = Field((0.0, 0.0), description="radial coefficient of r⁶")
    p1: Span[Coefficient] = Field((0.0, 0.0), description="tangential coefficient, along v")
    p2: Span[Coefficient] = Field((0.0, 0.0), description="tangential coefficient, along u")


class CameraSpec(Model):
    """The cameras. The tilt is drawn for each image, and everything else once for each camera."""

    half_angle_deg: Span[Annotated[FiniteFloat, Field(ge=5, le=70)]] = Field(
        (27.0, 27.0), description="deg; half the field of view across the image's shorter side"
    )
    aspect: Span[Annotated[FiniteFloat, Field(ge=0.5, le=2)]] = Field(
        (1.0, 1.0), description="focal length along v over that along u; 1 for square pixels"
    )
    psf_px: Span[Blur] = Field((0.8, 0.8), description="px; standard deviation of the lens's blur")
    tilt_deg: Span[Annotated[FiniteFloat, Field(ge=0, le=60)]] = Field(
        (0.0, 0.0), description="deg; angle between the camera's axis and the vertical, in any direction"
    )
    distortion: DistortionSpec = Field(DistortionSpec(), description="coefficients of the lenses")


class LensBlurSpec(Model):
    """Non-Gaussian blur of the lens, in addition to `camera.psf_px`; each part is off at 0."""

    disc_px: Span[BlurLength] = Field((0.0, 0.0), description="px; radius of the disc of defocus")
    coma_px: Span[BlurLength] = Field((0.0, 0.0), description="px; length C of the coma, in any direction")
    aperture_sides: Span[Annotated[FiniteFloat, Field(ge=0, le=10)]] = Field(
        (0.0, 0.0), description="marker sides; diameter of the opening, for discs that grow with the distance"
    )
    focus: Span[Annotated[FiniteFloat, Field(ge=0.1, le=10)]] = Field(
        (1.0, 1.0), description="focus distance over the distance of the scene in the image's middle"
    )


class ProcessingSpec(Model):
    """Image processing in the cameras after their sensors; each step is off by default."""

    demosaic: Literal["none", "bilinear", "edge-aware"] = Field(
        "none", description="a mosaic of colour filters after Bayer, and how colours between are interpolated"
    )
    red_gain: Span[BalanceGain] = Field((1.0, 1.0), description="white balance on red pixels")
    blue_gain: Span[BalanceGain] = Field((1.0, 1.0), description="white balance on blue pixels")
    gamma: Span[Gamma] = Field((1.0, 1.0), description="of the tone curve; 1 for a linear signal")
    s_curve: Span[Share] = Field((0.0, 0.0), description="strength of the curve that adds contrast")
    denoise: Span[Grey] = Field((0.0, 0.0), description="grey levels that are taken for noise")
    sharpen: Span[Sharpening] = Field((0.0, 0.0), description="amount of an unsharp mask")
    sharpen_px: Span[SharpeningRadius] = Field((1.0, 1.0), description="px; blur of that mask")
    h264_crf: Span[ConstantRateFactor] | None = Field(
        None, description="rate factor of an H.264 video whose first picture each image is; none if left out"
    )


class SensorSpec(Model):
    """Effects of the sensor on images: each is off at 0, `gain` at 1, `jpeg_quality` at None."""

    noise: Span[Grey] = Field((2.0, 2.0), description="grey levels; standard deviation")
    shot: Span[Share] = Field((0.0, 0.0), description="variance of shot noise for each grey level")
    gain: Span[Annotated[FiniteFloat, Field(ge=0.001, le=1000)]] = Field(
        (1.0, 1.0), description="grey levels out for each of light"
    )
    motion_px: Span[Annotated[FiniteFloat, Field(ge=0, le=40)]] = Field(
        (0.0, 0.0), description="px; length of the streak that a moving camera makes of a point"
    )
    vignetting: Span[Share] = Field((0.0, 0.0), description="share of light that the image's corners lack")
    gradient: Span[Share] = Field((0.0, 0.0), description="growth of the light from border to border")
    shadow: Span[Share] = Field((0.0, 0.0), description="share of light that a cast shadow takes away")
    jpeg_quality: Span[Annotated[int, Field(ge=1, le=100)]] | None = Field(
        None, description="quality, 1 to 100, of a JPEG that images go through; none if left out"
    )
    lens_blur: LensBlurSpec = Field(LensBlurSpec(), description="defocus and coma")
    processing: ProcessingSpec = Field(ProcessingSpec(), description="image processing in the cameras")
