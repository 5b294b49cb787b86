"""Measurement on photographs: every detector on every image of the sets, with confirmed counts."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from skyherd.bench.entrants import REFERENCE
from skyherd.bench.image_sets import ImageSet
from skyherd.bench.photographs.confirmation import Judged, Place, judge
from skyherd.bench.photographs.contact_sheet import PlaceTile, cut_tile
from skyherd.bench.photographs.sightings import Reader, make_readers
from skyherd.bench.result import Row
from skyherd.jobs.helpers import one_thread
from skyherd.jobs.progress import NO_PROGRESS, Progress

JUDGES = ("opencv", "apriltag3", "locus-tag", "photometric")
"""Names of the detectors that confirm markers, whichever are reported. They include at least one of each
family (`skyherd.bench.photographs.confirmation`), so that counts do not depend on the reported detectors."""


@dataclass
class Count:
    """Counts of one detector in one set.

    Attributes:
        found: confirmed markers that it found.
        photometric: those of them that it measured by a photometric fit.
        wrong_ids: confirmed markers at whose place it found another id.
        alone: places that no other family of detectors found.
        times_ms: time of each image.
    """

    found: int = 0
    photometric: int = 0
    wrong_ids: int = 0
    alone: int = 0
    times_ms: list[float] = field(default_factory=list)


@dataclass
class Measurement:
    """Result of the measurement.

    Attributes:
        rows: one for each set and detector, as the result has them.
        missed: one for each confirmed marker that a reported detector did not find.
        unconfirmed: one for each place that only one family found, or with a wrong id.
        missed_tiles: pictures of the missed markers, by the detector's name.
        unconfirmed_tiles: pictures of the unconfirmed ones, by the detector's name.
        refused: reasons why a detector could not read a set, by the names of set and detector.
    """

    rows: list[Row] = field(default_factory=list)
    missed: list[Row] = field(default_factory=list)
    unconfirmed: list[Row] = field(default_factory=list)
    missed_tiles: dict[str, list[PlaceTile]] = field(default_factory=dict)
    unconfirmed_tiles: dict[str, list[PlaceTile]] = field(default_factory=dict)
    refused: dict[str, dict[str, str]] = field(default_factory=dict)


def measure_photographs(
    image_sets: Sequence[ImageSet],
    reported: Sequence[str],
    judges: Sequence[str],
    *,
    progress: Progress = NO_PROGRESS,
) -> Measurement:
    """Run detectors on all images of all sets, each on one thread.

    Args:
        image_sets: the images and their markers.
        reported: names of the detectors that get rows.
        judges: names of additional detectors that confirm markers.
        progress: receives the number of processed files.

    Raises:
        InputError: an image cannot be read.
        EntrantError: a detector raised an exception.
    """
    measured = Measurement()
    names = list(dict.fromkeys([*judges, *reported]))
    with one_thread():
        for image_set in image_sets:
            readers, refused = make_readers(names, image_set.dictionary, image_set.marker_options())
            measured.refused[image_set.name] = {k: why for k, why in refused.items() if k in reported}
            _measure_set(measured, image_set, readers, [k for k in reported if k in readers], progress)
    return measured


def _measure_set(
    measured: Measurement,
    image_set: ImageSet,
    readers: dict[str, Reader],
    reported: Sequence[str],
    progress: Progress,
) -> None:
    counts = {name: Count() for name in readers}
    images = confirmed = 0
    for images, (file, image) in enumerate(image_set.images(), start=1):
        if images == 1:
            for reader in readers.values():
                reader.read(image)  # One-time setup, such as templates, does not count as time of an image.
        found = {name: reader.read(image) for name, reader in readers.items()}
        judged = judge(found, ids_repeat=image_set.model.ids_repeat)
        confirmed += len(judged.confirmed)
        for name, seen in found.items():
            counts[name].times_ms.append(seen.time_ms)
        _count(counts, judged)
        _record(measured, image_set.name, file, image, judged, reported)
        progress.update(image_set.name, images, None, f"{images} of {len(image_set.files)} or more")
    for name in reported:
        measured.rows.append(_row(image_set, name, counts, images, confirmed))


def _count(counts: dict[str, Count], judged: Judged) -> None:
    for name, count in counts.items():
        count.found += sum(name in place.found_by for place in judged.confirmed)
        count.photometric += sum(name in place.fitted_by for place in judged.confirmed)
        count.wrong_ids += sum(name in place.found_by for place in judged.mistaken)
        count.alone += sum(name in place.found_by for place in judged.alone)


def _record(
    measured: Measurement,
    set_name: str,
    file: str,
    image: npt.NDArray[np.uint8],
    judged: Judged,
    reported: Sequence[str],
) -> None:
    """Note the markers that a reported detector missed, and the unconfirmed places."""
    for place in judged.confirmed:
        missed_by = [name for name in reported if name not in place.found_by]
        if missed_by:
            row = _place_row(set_name, file, place) | {"missed_by": " ".join(missed_by)}
            measured.missed.append(row)
            _keep_tile(measured.missed_tiles, missed_by, image, file, place)
    for kind, places in (("wrong id", judged.mistaken), ("alone", judged.alone)):
        for place in places:
            found_by = [name for name in reported if name in place.found_by]
            if found_by:
                measured.unconfirmed.append(_place_row(set_name, file, place) | {"kind": kind})
                _keep_tile(measured.unconfirmed_tiles, found_by, image, file, place)


def _keep_tile(
    tiles: dict[str, list[PlaceTile]],
    names: Iterable[str],
    image: npt.NDArray[np.uint8],
    file: str,
    place: Place,
) -> None:
    tile = cut_tile(image, place, file)
    for name in names:
        tiles.setdefault(name, []).append(tile)


def _place_row(set_name: str, file: str, place: Place) -> Row:
    u, v = place.center_px
    return {
        "set": set_name,
        "image": file,
        "id": place.marker_id,
        "u_px": round(float(u), 2),
        "v_px": round(float(v), 2),
        "side_px": round(place.side_px, 2),
        "found_by": " ".join(place.found_by),
    }


def _row(image_set: ImageSet, name: str, counts: dict[str, Count], images: int, confirmed: int) -> Row:
    count, reference = counts[name], counts.get(REFERENCE)
    ratios = None if reference is None else np.divide(count.times_ms, reference.times_ms)
    return {
        "set": image_set.name,
        "dictionary": image_set.dictionary,
        "half": image_set.model.half or "",
        "detector": name,
        "images": images,
        "confirmed": confirmed,
        "found": count.found,
        "photometric": count.photometric,
        "recall": count.found / confirmed if confirmed else None,
        "wrong_ids": count.wrong_ids,
        "alone": count.alone,
        "ms_median": float(np.median(count.times_ms)),
        "times_reference": None if ratios is None else float(np.median(ratios)),
    }
