"""The spec of a labelled image set: read from TOML and checked, every key with its range.

Every value that varies is a range, `[least, greatest]`, from which it is drawn uniformly, or one number.
Lengths on the ground are in marker sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from skyherd.datasets.configuration.camera_models import CameraModel, DistortionModel
from skyherd.datasets.configuration.fields import Fraction, Model, Seed
from skyherd.datasets.configuration.file_kinds import DATASET, read_source, source_text
from skyherd.datasets.configuration.toml_files import built_in_names
from skyherd.datasets.configuration.validation import check_tree
from skyherd.datasets.labelled.camera_specs import CameraSpec, SensorSpec
from skyherd.datasets.labelled.scene_specs import GroundSpec, MarkersSpec, OccludersSpec
from skyherd.errors import InputError
from skyherd.files.images import MAX_BYTES, read_grey
from skyherd.files.reading import read_bytes
from skyherd.markers.dictionary import card_side

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

    description: str = Field("", description="purpose of the set")
    seed: Seed = Field(1, description="seed of all random draws")
    images: Annotated[int, Field(ge=1, le=1_000_000)] = Field(description="number of images")
    size_px: tuple[Size, Size] = Field((640, 480), description="px; width and height of every image")
    validation: Fraction = Field(0.2, description="share of the images that are kept for validation")
    cameras: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        8, description="number of cameras, each with its own lens and ground"
    )
    markers: MarkersSpec = Field(MarkersSpec(), description="the markers of an image")
    camera: CameraSpec = Field(CameraSpec(), description="the cameras")
    sensor: SensorSpec = Field(SensorSpec(), description="sensors of the cameras")
    ground: GroundSpec = Field(GroundSpec(), description="the ground under the markers")
    occluders: OccludersSpec = Field(OccludersSpec(), description="occluders over markers")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        widest, steepest = self.camera.half_angle_deg[1], self.camera.tilt_deg[1]
        corner = np.hypot(*self.size_px) / min(self.size_px) * np.tan(np.radians(widest))
        oblique = float(np.degrees(np.arctan(corner))) + steepest
        if oblique > MAX_OBLIQUE_DEG:
            what = f"{steepest:g} at half_angle_deg {widest:g} looks {oblique:.0f} deg sideways"
            raise InputError(
                "camera.tilt_deg", what, f"at most {MAX_OBLIQUE_DEG:g} deg in the image's corners"
            )
        room = min(self.size_px) / (card_side(self.markers.dictionary) * 2**0.5)
        if self.markers.side_px[1] > room:
            what = f"up to {self.markers.side_px[1]:g}"
            raise InputError("markers.side_px", what, f"at most {room:.0f}, which fits into the image")
        for problem in filter(None, map(self._lens_problem, self._extreme_lenses())):
            raise problem.within_key("camera")
        return self

    def _extreme_lenses(self) -> list[DistortionModel]:
        """A lens folds the image where a form that is linear in its coefficients turns negative."""
        spans = self.camera.distortion.model_dump()
        ends = product(*(sorted(set(span)) for span in spans.values()))
        return [DistortionModel(**dict(zip(spans, end, strict=True))) for end in ends]

    def _lens_problem(self, lens: DistortionModel) -> InputError | None:
        widest = self.camera.half_angle_deg[1]
        return CameraModel(size_px=self.size_px, half_angle_deg=widest, distortion=lens).lens_problem(1.0)

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
    return built_in_names(DATASET.package)


def spec_text(name: str) -> str:
    """TOML text of a built-in spec.

    Raises:
        InputError: there is none of that name.
    """
    return source_text(name, DATASET)


def load_spec(name_or_file: str, *, seed: int | None = None, images: int | None = None) -> SpecFile:
    """Read and check a built-in spec or a TOML file; `seed` and number of `images` are put over it if given.

    Raises:
        InputError: a line for each problem: the file or the option, the key, the value, and what is allowed.
    """
    source = read_source(name_or_file, DATASET)
    given = {key: value for key, value in {"seed": seed, "images": images}.items() if value is not None}
    spec = make_spec(source.tree | given, source.where, origins={key: f"--{key}" for key in given})
    file = SpecFile(spec, source.folder)
    for name in file.spec.ground.images:
        read_grey(file.folder / name)
    return file


def make_spec(
    tree: dict[str, Any], where: str = "dataset", *, origins: Mapping[str, str] | None = None
) -> DatasetSpec:
    """Check a spec given as a tree of plain values.

    Args:
        tree: dictionaries, lists and plain values, as in a TOML file.
        where: what to call it in a problem.
        origins: options that gave values, by dotted key, to name them as the places of problems.

    Raises:
        InputError: a line for each problem: the key, the value, and what is allowed.
    """
    return check_tree(DatasetSpec, tree, where, see=DATASET.schema, origins=origins)
