"""Reader of labelled image sets: images and their ground truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from skyherd.datasets.labelled.folder import open_folder
from skyherd.datasets.labelled.formats.truth_table import no_labels, read_labels, read_table
from skyherd.datasets.labelled.labels import Labels
from skyherd.datasets.labelled.spec import DatasetSpec
from skyherd.errors import InputError
from skyherd.files.images import Grey, read_grey
from skyherd.messages.checks import check_kind


@dataclass(frozen=True)
class LabelledImage:
    """Image with its ground truth.

    Attributes:
        name: the file, relative to the set's folder.
        path: the file.
        split: `train` or `val`.
        labels: ground truth of its markers.
        taken: imaging conditions: the texts of its row in `images.csv`, by column.
    """

    name: str
    path: Path
    split: str
    labels: Labels
    taken: dict[str, str]

    def read(self) -> Grey:
        """Read the image: grey levels (height, width).

        Raises:
            InputError: the file is damaged or missing.
        """
        return read_grey(self.path)


@dataclass(frozen=True)
class Dataset:
    """Labelled image set: a sequence of its images, in the order of their numbers.

    Attributes:
        path: its folder.
        spec: the spec from which it was made.
        images: all images.
    """

    path: Path
    spec: DatasetSpec
    images: tuple[LabelledImage, ...]

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[LabelledImage]:
        return iter(self.images)

    def __getitem__(self, index: int) -> LabelledImage:
        return self.images[index]

    @property
    def markers(self) -> int:
        """Number of labelled markers in all images."""
        return sum(len(image.labels) for image in self)


def read_dataset(path: Path | str) -> Dataset:
    """Read the output folder of `skyherd dataset make`; `LabelledImage.read` reads the images later.

    Raises:
        InputError: the folder has no labelled set, or one of its tables is damaged or missing.
    """
    check_kind("read_dataset: path", path, (str, Path), "a path")
    folder = open_folder(Path(path))
    labels, taken = read_labels(folder.truth), read_table(folder.images, ("image", "split"))
    names = [folder.image_name(index) for index in range(folder.spec.images)]
    if [row["image"] for row in taken] != names:
        raise InputError(
            str(folder.images), f"not the {len(names)} images of its spec, in order", "make it again"
        )
    if strangers := sorted(labels.keys() - set(names)):
        raise InputError(str(folder.truth), f"{strangers[0]} is not an image of the set", "make it again")
    images = (
        LabelledImage(
            name=name,
            path=folder.path / name,
            split=row["split"],
            labels=labels.get(name, no_labels()),
            taken=row,
        )
        for name, row in zip(names, taken, strict=True)
    )
    return Dataset(folder.path, folder.spec, tuple(images))
