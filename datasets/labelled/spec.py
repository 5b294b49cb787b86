"""Spec of a labelled image set, read from TOML and validated.

Every variable is a range, `[least, greatest]`, with uniform distribution, or one number. Lengths on the
ground are in marker sides.
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
"""Maximum angle between a ray of an image and the vertical, deg. Chosen: at 80 deg the ground is six times as
far as straight below; at 90 deg it is the horizon."""

SPLIT_ROUNDING = 1e-9
"""Added to a number of images before truncation. Chosen: above the rounding of products such as `5 * 0.2`."""

Size = Annotated[int, Field(ge=64, le=8192)]
"""Width or height of an image, px."""


class DatasetSpec(Model):
    """Spec of a set: all inputs of each image, with the seed."""

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
        """Return the lenses at the ends of all ranges.

        A lens folds the image where a form that is linear in its coefficients becomes negative. The extremes
        of the form are therefore at these ends.
        """
        spans = self.camera.distortion.model_dump()
        ends = product(*(sorted(set(span)) for span in spans.values()))
        return [DistortionModel(**dict(zip(spans, end, strict=True))) for end in ends]

    def _lens_problem(self, lens: DistortionModel) -> InputError | None:
        widest = self.camera.half_angle_deg[1]
        return CameraModel(size_px=self.size_px, half_angle_deg=widest, distortion=lens).lens_problem(1.0)

    def is_validation(self, index: int) -> bool:
        """Return True if an image, given by its number, is for validation; such images are evenly spread."""
        return int((index + 1) * self.validation + SPLIT_ROUNDING) > int(
            index * self.validation + SPLIT_ROUNDING
        )


@dataclass(frozen=True)
class SpecFile:
    """Validated spec, and the base folder of its pictures."""

    spec: DatasetSpec
    folder: Path = Path()

    def pictures(self) -> dict[str, str]:
        """Return the SHA-256 of each picture in the spec; the images depend on these as well."""
        return {
            name: sha256(read_bytes(self.folder / name, "a picture", MAX_BYTES)).hexdigest()
            for name in self.spec.ground.images
        }


def spec_names() -> list[str]:
    """Return the names of the built-in specs, in alphabetical order."""
    return built_in_names(DATASET.package)


def spec_text(name: str) -> str:
    """Return the TOML text of a built-in spec.

    Raises:
        InputError: no built-in spec has that name.
    """
    return source_text(name, DATASET)


def load_spec(name_or_file: str, *, seed: int | None = None, images: int | None = None) -> SpecFile:
    """Read and validate a built-in spec or a TOML file; `seed` and `images` replace its values if given.

    Raises:
        InputError: one line per problem: the file or the option, the key, the value, and the allowed values.
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
    """Validate a spec given as a tree of plain values.

    Args:
        tree: dictionaries, lists and plain values, as in a TOML file.
        where: name of the spec in error messages.
        origins: command-line options that set values, by dotted key; error messages name them.

    Raises:
        InputError: one line per problem: the key, the value, and the allowed values.
    """
    return check_tree(DatasetSpec, tree, where, see=DATASET.schema, origins=origins)
