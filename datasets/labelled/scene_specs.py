"""Scenes of a labelled image set: markers, the ground under them, and occluders."""

from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from skyherd.datasets.configuration.fields import MAX_ROBOTS, DictionaryName, Model, Positive, Share
from skyherd.datasets.configuration.robot_models import MarkerId
from skyherd.datasets.configuration.scene_models import Grey
from skyherd.datasets.labelled.ranges import Span
from skyherd.errors import InputError
from skyherd.markers.dictionary import dictionary_size

Side = Annotated[FiniteFloat, Field(ge=6, le=2000)]
"""Side of a marker in the image, px. Chosen: 6 px is one a cell for the smallest dictionaries."""


class MarkersSpec(Model):
    """The markers of an image; all have the same size on the ground, and no two cards touch."""

    dictionary: DictionaryName = Field(
        "4X4_50", description="marker dictionary, named as in `skyherd markers --help` or in OpenCV"
    )
    ids: list[MarkerId] | None = Field(
        None,
        min_length=1,
        max_length=MAX_ROBOTS,
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
            raise InputError(
                "ids", "a repeated or unknown id", f"0 to {most - 1} in {self.dictionary}, each once"
            )
        if self.count[1] > len(ids):
            raise InputError("count", f"up to {self.count[1]}", f"at most {len(ids)}, the number of markers")
        if self.black[1] >= self.white[0]:
            what = f"up to {self.black[1]:g}, with white from {self.white[0]:g}"
            raise InputError("black", what, "darker than white over the whole of both ranges")
        return self


class GroundSpec(Model):
    """The ground under the markers: one for each camera, with individual clutter in each image."""

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
            raise InputError("", "neither kinds nor images given", "at least one of the two")
        return self


class OccludersSpec(Model):
    """Discs and squares that lie over markers."""

    share: Share = Field(0.0, description="chance of each marker that something lies on it, 0 to 1")
    radius_sides: Span[Annotated[FiniteFloat, Field(gt=0, le=5)]] = Field(
        (0.2, 0.5), description="marker sides; radius of a disc, or half the side of a square"
    )
    level: Span[Grey] = Field((20.0, 220.0), description="grey level of what lies on it")
