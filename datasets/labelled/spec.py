"""The spec of a labelled image set: read from TOML and checked, every key with its range.

Every value that varies is a range, `[least, greatest]`, from which it is drawn uniformly, or one number.
Lengths on the ground are in marker sides.
"""

from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, ValidationError, model_validator

from skyherd.datasets.configuration.camera_models import CameraModel, Coefficient, DistortionModel
from skyherd.datasets.configuration.fields import MOST_ROBOTS, Fraction, Model, Positive, Seed, Share
from skyherd.datasets.configuration.robot_models import MarkerId
from skyherd.datasets.configuration.scene_models import (
    BalanceGain,
    BlurLength,
    ConstantRateFactor,
    Gamma,
    Grey,
    Sharpening,
    SharpeningRadius,
)
from skyherd.datasets.configuration.toml_files import (
    built_in_names,
    built_in_text,
    first_error,
    parse_toml,
    read_toml_text,
)
from skyherd.datasets.labelled.ranges import Span
from skyherd.files.images import MAX_BYTES, read_grey
from skyherd.files.reading import is_regular, read_bytes
from skyherd.markers.dictionary import card_side, dictionary_size

BUILT_IN = "skyherd.datasets.specs"
"""Package of the built-in specs."""

MOST_OBLIQUE_DEG = 80.0
"""Largest angle between a ray of an image and the vertical, degrees. *Chosen*: at 80 the ground is six times
as far as straight below; at 90 it is the horizon."""

SPLIT_ROUNDING = 1e-9
"""Added before cutting off decimals of a number of images. *Chosen*: makes up for the rounding of products
such as `5 * 0.2`."""

Blur = Annotated[FiniteFloat, Field(ge=0.3, le=5)]
"""Standard deviation of a lens's blur, px. *Chosen*: from sharp lenses to images out of focus."""

Side = Annotated[FiniteFloat, Field(ge=6, le=2000)]
"""Side of a marker in the image, px. *Chosen*: 6 px is one a cell for the smallest dictionaries."""

Size = Annotated[int, Field(ge=64, le=8192)]
"""Width or height of an image, px."""


class MarkersSpec(Model):
    """The markers of an image; all have one size on the ground, and no two cards touch."""

    dictionary: str = Field("4X4_50", description="marker dictionary, named as in `skyherd markers --help`")
    ids: list[MarkerId] | None = Field(
        None,
        min_length=1,
        max_length=MOST_ROBOTS,
        description="markers that may appear; all of the dictionary if left out",
    )
    count: Span[Annotated[int, Field(ge=0, le=1000)]] = Field(
        (4, 12), description="markers in an image; fewer where no more have room"
    )
    side_px: Span[Side] = Field(
        (16.0, 80.0), description="px; side of the black square in the image's middle"
    )
    black: Span[Grey] = Field((30.0, 30.0), description="grey level of the markers' black")
    white: Span[Grey] = Field((230.0, 230.0), description="grey level of the white card")
    cut: Share = Field(0.0, description="chance of each marker to be cut by the image's border, 0 to 1")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        most = dictionary_size(self.dictionary)
        ids = self.ids if self.ids is not None else range(most)
        if len(set(ids)) != len(ids) or max(ids) >= most:
            raise ValueError(f"ids must be from 0 to {most - 1} in {self.dictionary}, and each once")
        if self.count[1] > len(ids):
            raise ValueError(f"count goes to {self.count[1]}, but there are {len(ids)} different markers")
        if self.black[1] >= self.white[0]:
            raise ValueError("black must be darker than white over the whole of their ranges")
        return self


class DistortionSpec(Model):
    """Coefficients of the lenses after Brown and Conrady, as OpenCV names them."""

    k1: Span[Coefficient] = Field((0.0, 0.0), description="radial coefficient of r²")
    k2: Span[Coefficient] = Field((0.0, 0.0), description="radial coefficient of r⁴")
    k3: Span[Coefficient] = Field((0.0, 0.0), description="radial coefficient of r⁶")
    p1: Span[Coefficient] = Field((0.0, 0.0), description="tangential coefficient, along v")
    p2: Span[Coefficient] = Field((0.0, 0.0), description="tangential coefficient, along u")


class CameraSpec(Model):
    """The cameras; all is drawn once for each camera, but the tilt, which is drawn for each image."""

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
    """Blur of the lens that is no Gaussian, beside `camera.psf_px`; each part is off at 0."""

    disc_px: Span[BlurLength] = Field((0.0, 0.0), description="px; radius of the disc of defocus")
    coma_px: Span[BlurLength] = Field((0.0, 0.0), description="px; length C of the coma, in any direction")
    aperture_sides: Span[Annotated[FiniteFloat, Field(ge=0, le=10)]] = Field(
        (0.0, 0.0), description="marker sides; diameter of the opening, for discs that grow with the distance"
    )
    focus: Span[Annotated[FiniteFloat, Field(ge=0.1, le=10)]] = Field(
        (1.0, 1.0), description="distance in focus over that of what is in the image's middle"
    )


class ProcessingSpec(Model):
    """What the cameras do to images after their sensors; each part is off unless it is set."""

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
    """What the sensor does to images; each part is off at 0, gain at 1, jpeg_quality if left out."""

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
    processing: ProcessingSpec = Field(ProcessingSpec(), description="what cameras do to their images")


class GroundSpec(Model):
    """The ground under the markers: one for each camera, with clutter that each image has of its own."""

    kinds: list[Literal["plain", "concrete", "tiles"]] = Field(
        ["concrete"], description="kinds of ground; each is as likely as any other, and as any of `images`"
    )
    images: list[str] = Field([], max_length=100, description="picture files, relative to the spec's folder")
    mean: Span[Grey] = Field((128.0, 128.0), description="mean grey level; pictures have their own")
    contrast: Span[Grey] = Field((12.0, 12.0), description="grey levels; standard deviation")
    tile_sides: Span[Positive] = Field((3.0, 8.0), description="marker sides; side of a tile")
    image_sides: Span[Positive] = Field((20.0, 20.0), description="marker sides; width of a picture")
    clutter: Span[Annotated[int, Field(ge=0, le=500)]] = Field(
        (0, 0), description="about how many dark quadrilaterals are in an image"
    )

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not self.kinds and not self.images:
            raise ValueError("give at least one of kinds and images")
        return self


class OccludersSpec(Model):
    """Discs and squares that lie over markers."""

    share: Share = Field(0.0, description="chance of each marker that something lies on it, 0 to 1")
    radius_sides: Span[Annotated[FiniteFloat, Field(gt=0, le=5)]] = Field(
        (0.2, 0.5), description="marker sides; radius of a disc, or half the side of a square"
    )
    level: Span[Grey] = Field((20.0, 220.0), description="grey level of what lies on it")


class DatasetSpec(Model):
    """The spec of a set: with the seed, all that each image follows from."""

    description: str = Field("", description="what the set is for, for people")
    seed: Seed = Field(1, description="seed of all random draws")
    images: Annotated[int, Field(ge=1, le=1_000_000)] = Field(description="number of images")
    size_px: tuple[Size, Size] = Field((640, 480), description="px; width and height of every image")
    validation: Fraction = Field(0.2, description="share of the images that are kept for validation")
    cameras: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        8, description="different cameras, each with its lens, over a ground of its own"
    )
    markers: MarkersSpec = Field(MarkersSpec(), description="the markers of an image")
    camera: CameraSpec = Field(CameraSpec(), description="the cameras")
    sensor: SensorSpec = Field(SensorSpec(), description="what the sensor does to images")
    ground: GroundSpec = Field(GroundSpec(), description="the ground under the markers")
    occluders: OccludersSpec = Field(OccludersSpec(), description="what lies over markers")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        widest, steepest = self.camera.half_angle_deg[1], self.camera.tilt_deg[1]
        corner = np.hypot(*self.size_px) / min(self.size_px) * np.tan(np.radians(widest))
        oblique = float(np.degrees(np.arctan(corner))) + steepest
        if oblique > MOST_OBLIQUE_DEG:
            raise ValueError(
                f"tilt_deg {steepest:g} at half_angle_deg {widest:g} looks {oblique:.0f} deg sideways; "
                f"at most {MOST_OBLIQUE_DEG:g}"
            )
        room = min(self.size_px) / (card_side(self.markers.dictionary) * 2**0.5)
        if self.markers.side_px[1] > room:
            raise ValueError(f"markers.side_px goes to {self.markers.side_px[1]:g}; at most {room:.0f} fits")
        for complaint in filter(None, map(self._lens_complaint, self._extreme_lenses())):
            raise ValueError(complaint)
        return self

    def _extreme_lenses(self) -> list[DistortionModel]:
        """A lens folds the image where a form that is linear in its coefficients turns negative."""
        spans = self.camera.distortion.model_dump()
        ends = product(*(sorted(set(span)) for span in spans.values()))
        return [DistortionModel(**dict(zip(spans, end, strict=True))) for end in ends]

    def _lens_complaint(self, lens: DistortionModel) -> str | None:
        widest = self.camera.half_angle_deg[1]
        return CameraModel(size_px=self.size_px, half_angle_deg=widest, distortion=lens).lens_complaint(1.0)

    def is_validation(self, index: int) -> bool:
        """Whether an image, given by its number, is kept for validation; such images are evenly spread."""
        return int((index + 1) * self.validation + SPLIT_ROUNDING) > int(
            index * self.validation + SPLIT_ROUNDING
        )


@dataclass(frozen=True)
class SpecFile:
    """A checked spec, and the folder to which its pictures' names are relative."""

    spec: DatasetSpec
    folder: Path = Path()

    def pictures(self) -> dict[str, str]:
        """SHA-256 of each picture that the spec names, since the images follow from these as well."""
        return {
            name: sha256(read_bytes(self.folder / name, "a picture", MAX_BYTES)).hexdigest()
            for name in self.spec.ground.images
        }


def spec_names() -> list[str]:
    """Names of the built-in specs, in alphabetical order."""
    return built_in_names(BUILT_IN)


def spec_text(name: str) -> str:
    """TOML text of a built-in spec.

    Raises:
        InputError: there is none of that name.
    """
    return built_in_text(BUILT_IN, name, "dataset")


def load_spec(name_or_file: str, *, seed: int | None = None, images: int | None = None) -> SpecFile:
    """Read and check a built-in spec or a TOML file; `seed` and number of `images` are put over it if given.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    path = Path(name_or_file)
    is_file = path.suffix == ".toml" or is_regular(path)
    where = str(path) if is_file else f"dataset {name_or_file}"
    tree = parse_toml(
        read_toml_text(path, "dataset spec") if is_file else spec_text(name_or_file),
        where,
        "skyherd dataset show small",
    )
    tree |= {key: value for key, value in {"seed": seed, "images": images}.items() if value is not None}
    file = SpecFile(make_spec(tree, where), path.parent if is_file else Path())
    for name in file.spec.ground.images:
        read_grey(file.folder / name)
    return file


def make_spec(tree: dict[str, Any], where: str = "dataset") -> DatasetSpec:
    """Check a spec given as a tree of plain values.

    Raises:
        InputError: in one line, the key, the value, and what is allowed.
    """
    try:
        return DatasetSpec.model_validate(tree)
    except ValidationError as error:
        raise first_error(error, where, "dataset") from None
