"""What a labelled image set is to be: read from TOML and checked, every key with its range.

Every value that varies is a range, `[least, greatest]`, drawn uniformly, or one number. Lengths on the
ground are in marker sides.
"""

from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, ValidationError, model_validator

from skyherd.datasets.configuration.camera_models import CameraModel, Coefficient, DistortionModel
from skyherd.datasets.configuration.fields import Fraction, Model, NotNegative, Positive, Share
from skyherd.datasets.configuration.scene_models import Grey
from skyherd.datasets.configuration.toml_files import (
    built_in_names,
    built_in_text,
    first_error,
    parse_toml,
    read_text,
)
from skyherd.datasets.labelled.ranges import Span
from skyherd.files.images import read_grey
from skyherd.markers.dictionary import card_side, dictionary_size

BUILT_IN = "skyherd.datasets.specs"
MOST_OBLIQUE_DEG = 80.0
"""No ray of an image may meet the ground at more than this from the vertical."""

Blur = Annotated[FiniteFloat, Field(ge=0.3, le=5)]
Side = Annotated[FiniteFloat, Field(ge=6, le=2000)]
Size = Annotated[int, Field(ge=64, le=8192)]


class MarkersSpec(Model):
    """The markers of an image; all have one size on the ground, and no two cards touch."""

    dictionary: str = Field("4X4_50", description="of the markers: `skyherd markers --help`")
    ids: list[Annotated[int, Field(ge=0)]] | None = Field(
        None, min_length=1, description="markers that may appear; all of the dictionary if left out"
    )
    count: Span[Annotated[int, Field(ge=0, le=1000)]] = Field(
        (4, 12), description="markers in an image; fewer where no more have room"
    )
    side_px: Span[Side] = Field((16.0, 80.0), description="side of the black square in the image's middle")
    black: Span[Grey] = Field((30.0, 30.0), description="grey level of the markers' black")
    white: Span[Grey] = Field((230.0, 230.0), description="grey level of the card")
    cut: Share = Field(0.0, description="chance of each marker to be cut by the image's border")

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

    k1: Span[Coefficient] = Field((0.0, 0.0), description="radial, of the square of the distance")
    k2: Span[Coefficient] = Field((0.0, 0.0), description="radial, of its fourth power")
    k3: Span[Coefficient] = Field((0.0, 0.0), description="radial, of its sixth power")
    p1: Span[Coefficient] = Field((0.0, 0.0), description="tangential, along v")
    p2: Span[Coefficient] = Field((0.0, 0.0), description="tangential, along u")


class CameraSpec(Model):
    """The cameras; all but the tilt, which each image has its own of, is drawn once a camera."""

    half_angle_deg: Span[Annotated[FiniteFloat, Field(ge=5, le=70)]] = Field(
        (27.0, 27.0), description="half the field of view across the image's shorter side"
    )
    aspect: Span[Annotated[FiniteFloat, Field(ge=0.5, le=2)]] = Field(
        (1.0, 1.0), description="focal length along v over along u"
    )
    psf_px: Span[Blur] = Field((0.8, 0.8), description="standard deviation of the lens's blur")
    tilt_deg: Span[Annotated[FiniteFloat, Field(ge=0, le=60)]] = Field(
        (0.0, 0.0), description="angle between the camera's axis and the vertical, in any direction"
    )
    distortion: DistortionSpec = DistortionSpec()


class SensorSpec(Model):
    """What images suffer; each is off at 0, gain at 1, jpeg_quality when left out."""

    noise: Span[NotNegative] = Field((2.0, 2.0), description="standard deviation, grey levels")
    shot: Span[Share] = Field((0.0, 0.0), description="variance of shot noise a grey level of signal")
    gain: Span[Positive] = Field((1.0, 1.0), description="grey levels out for one in")
    motion_px: Span[Annotated[FiniteFloat, Field(ge=0, le=40)]] = Field(
        (0.0, 0.0), description="length of the streak that a moving camera makes of a point"
    )
    vignetting: Span[Share] = Field((0.0, 0.0), description="share of light that the image's corners lack")
    gradient: Span[Share] = Field((0.0, 0.0), description="growth of the light from border to border")
    shadow: Span[Share] = Field((0.0, 0.0), description="share of light that a cast shadow takes away")
    jpeg_quality: Span[Annotated[int, Field(ge=1, le=100)]] | None = Field(
        None, description="images go through a JPEG before they are stored without loss"
    )


class GroundSpec(Model):
    """What lies under the markers; one for each camera, but the clutter, of which each image has its own."""

    kinds: list[Literal["plain", "concrete", "tiles"]] = Field(
        ["concrete"], description="each as likely as any other, and as any of `images`"
    )
    images: list[str] = Field([], max_length=100, description="picture files, beside the spec")
    mean: Span[Grey] = Field((128.0, 128.0), description="grey level; pictures have their own")
    contrast: Span[NotNegative] = Field((12.0, 12.0), description="standard deviation, grey levels")
    tile_sides: Span[Positive] = Field((3.0, 8.0), description="side of a tile, marker sides")
    image_sides: Span[Positive] = Field((20.0, 20.0), description="width of a picture, marker sides")
    clutter: Span[Annotated[int, Field(ge=0, le=500)]] = Field(
        (0, 0), description="dark quadrilaterals in an image, about"
    )

    @model_validator(mode="after")
    def _some(self) -> Self:
        if not self.kinds and not self.images:
            raise ValueError("give at least one of kinds and images")
        return self


class OccludersSpec(Model):
    """Discs and squares that lie over markers."""

    share: Share = Field(0.0, description="chance of each marker that something lies on it")
    radius_sides: Span[Annotated[FiniteFloat, Field(gt=0, le=5)]] = Field(
        (0.2, 0.5), description="radius of a disc, half the side of a square; marker sides"
    )
    level: Span[Grey] = Field((20.0, 220.0), description="grey level")


class DatasetSpec(Model):
    """A labelled image set: each image follows from seed and number, and from nothing else."""

    description: str = Field("", description="what it is for")
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(1, description="of everything")
    images: Annotated[int, Field(ge=1, le=1_000_000)] = Field(description="how many")
    size_px: tuple[Size, Size] = Field((640, 480), description="width and height of every image")
    validation: Fraction = Field(0.2, description="share of the images that are kept for validation")
    cameras: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        8, description="different cameras, each with its lens, over a ground of its own"
    )
    markers: MarkersSpec = MarkersSpec()
    camera: CameraSpec = CameraSpec()
    sensor: SensorSpec = SensorSpec()
    ground: GroundSpec = GroundSpec()
    occluders: OccludersSpec = OccludersSpec()

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
        """Whether an image is kept for validation: so many in any run of images, whatever their number."""
        return int((index + 1) * self.validation + 1e-9) > int(index * self.validation + 1e-9)


@dataclass(frozen=True)
class SpecFile:
    """A checked spec, and the folder beside which its pictures lie."""

    spec: DatasetSpec
    folder: Path = Path()

    def pictures(self) -> dict[str, str]:
        """SHA-256 of each picture that it names: the images follow from these as well."""
        return {
            name: sha256((self.folder / name).read_bytes()).hexdigest() for name in self.spec.ground.images
        }


def spec_names() -> list[str]:
    """Names of the built-in specs."""
    return built_in_names(BUILT_IN)


def spec_text(name: str) -> str:
    """TOML text of a built-in spec."""
    return built_in_text(BUILT_IN, name, "dataset")


def load_spec(name_or_file: str, *, seed: int | None = None, images: int | None = None) -> SpecFile:
    """Read and check a built-in spec or a TOML file; seed and number of images may be put over it.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    path = Path(name_or_file)
    is_file = path.suffix == ".toml" or path.is_file()
    where = str(path) if is_file else f"dataset {name_or_file}"
    tree = parse_toml(
        read_text(path, "dataset spec") if is_file else spec_text(name_or_file),
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
