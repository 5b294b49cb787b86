"""The spec of a labelled image set: read from TOML and checked, every key with its range.

Every value that varies is a range, `[least, greatest]`, from which it is drawn uniformly, or one number.
Lengths on the ground are in marker sides.
"""

from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from skyherd.datasets.configuration.camera_models import CameraModel, DistortionModel
from skyherd.datasets.configuration.fields import Fraction, Model, Seed
from skyherd.datasets.configuration.toml_files import (
    built_in_names,
    built_in_text,
    first_error,
    parse_toml,
    read_toml_text,
)
from skyherd.datasets.labelled.camera_specs import CameraSpec, SensorSpec
from skyherd.datasets.labelled.scene_specs import GroundSpec, MarkersSpec, OccludersSpec
from skyherd.files.images import MAX_BYTES, read_grey
from skyherd.files.reading import is_regular, read_bytes
from skyherd.markers.dictionary import card_side

BUILT_IN = "skyherd.datasets.specs"
"""Package of the built-in specs."""

MAX_OBLIQUE_DEG = 80.0
"""Largest angle between a ray of an image and the vertical, degrees. *Chosen*: at 80 the ground is six times
as far as straight below; at 90 it is the horizon."""

SPLIT_ROUNDING = 1e-9
"""Added before cutting off decimals of a number of images. *Chosen*: makes up for the rounding of products
such as `5 * 0.2`."""

Size = Annotated[int, Field(ge=64, le=8192)]
"""Width or height of an image, px."""


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
        if oblique > MAX_OBLIQUE_DEG:
            raise ValueError(
                f"tilt_deg {steepest:g} at half_angle_deg {widest:g} looks {oblique:.0f} deg sideways; "
                f"at most {MAX_OBLIQUE_DEG:g}"
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
