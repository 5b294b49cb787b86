"""Measurement on boards: every detector on every image, with and without added noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from skyherd.bench.boards.accuracy import (
    QUANTITIES,
    RAYLEIGH_MEDIAN,
    MarkerErrors,
    collect_errors,
    find_floor,
    only,
    turns_deg,
)
from skyherd.bench.boards.board_errors import BoardErrors, Fitted, learn_board_errors
from skyherd.bench.boards.image_noise import immerkaer_noise
from skyherd.bench.boards.layout import BoardModel, board_corners
from skyherd.bench.boards.lens_degree import choose_degrees, fit_images
from skyherd.bench.entrants import REFERENCE
from skyherd.bench.image_sets import ImageSet
from skyherd.bench.photographs.confirmation import judge
from skyherd.bench.photographs.sightings import Reader, Sightings, make_readers
from skyherd.bench.result import Row
from skyherd.errors import InputError
from skyherd.geometry import MEDIAN_PER_SIGMA
from skyherd.jobs.helpers import one_thread
from skyherd.jobs.progress import NO_PROGRESS, Progress

ADDED_NOISE = 5.0
"""Standard deviation of the noise added to images, grey levels. Chosen: moves detections by several times
their resolution, and changes no threshold of a detector on boards of usual contrast."""

COMMON_RECALL = 0.8
"""Minimum recall of a detector that defines the common markers. Chosen: a detector with low recall would
leave almost no common marker."""


@dataclass(frozen=True)
class SetErrors:
    """Errors of one set.

    Attributes:
        errors: errors of each detector, by name.
        floors: common standard deviation, by quantity, per axis; None if unknown.
    """

    errors: dict[str, MarkerErrors]
    floors: dict[str, float | None]


@dataclass
class Measurement:
    """Result of the measurement.

    Attributes:
        rows: one for each set and detector.
        sets: the errors behind them, by the set's name.
        boards: nominal corners (K, 4, 2) and learned errors of each board, by its name.
        refused: reasons why a detector could not read a set, by the names of set and detector.
    """

    rows: list[Row] = field(default_factory=list)
    sets: dict[str, SetErrors] = field(default_factory=dict)
    boards: dict[str, tuple[npt.NDArray[np.float64], BoardErrors]] = field(default_factory=dict)
    refused: dict[str, dict[str, str]] = field(default_factory=dict)


@dataclass
class _SetRun:
    """Detections in the images of one set."""

    image_set: ImageSet
    board: BoardModel
    clean: list[dict[str, Sightings]] = field(default_factory=list)
    noisy: list[dict[str, Sightings]] = field(default_factory=list)
    times_ms: dict[str, list[float]] = field(default_factory=dict)
    found: dict[str, int] = field(default_factory=dict)
    confirmed: int = 0
    images: int = 0
    noises: list[float] = field(default_factory=list)


def measure_boards(
    image_sets: Sequence[ImageSet],
    reported: Sequence[str],
    judges: Sequence[str],
    *,
    progress: Progress = NO_PROGRESS,
) -> Measurement:
    """Measure the accuracy of detectors on all sets that show a board.

    Args:
        image_sets: the images; sets without a board are left out.
        reported: names of the detectors that get rows.
        judges: names of additional detectors that take part in learning and confirming.
        progress: receives the number of processed images.

    Raises:
        InputError: no set has a board, or an image cannot be read.
        EntrantError: a detector raised an exception.
    """
    shown = [one for one in image_sets if one.model.board is not None]
    if not shown:
        raise InputError("sets", "no set has a board", "a table `board`; see docs/how-to/boards.md")
    measured = Measurement()
    names = list(dict.fromkeys([*judges, *reported]))
    runs: dict[str, list[_SetRun]] = {}
    with one_thread():
        for image_set in shown:
            readers, refused = make_readers(names, image_set.dictionary, image_set.marker_options())
            measured.refused[image_set.name] = {name: refused[name] for name in reported if name in refused}
            assert image_set.model.board is not None
            board = image_set.model.board
            same = runs.setdefault(board.name or image_set.name, [])
            same.append(_run_set(image_set, board, readers, progress))
    for name, same in runs.items():
        _measure_board(measured, name, same, reported)
    return measured


def _run_set(
    image_set: ImageSet, board: BoardModel, readers: dict[str, Reader], progress: Progress
) -> _SetRun:
    run = _SetRun(image_set, board)
    for name in readers:
        run.times_ms[name], run.found[name] = [], 0
    for number, (_, image) in enumerate(image_set.images()):
        noise = np.random.default_rng(number).normal(0.0, ADDED_NOISE, image.shape)
        noisy = np.clip(np.rint(image + noise), 0, 255).astype(np.uint8)
        if number == 0:
            for reader in readers.values():
                reader.read(image)  # One-time setup does not count as time of an image.
        found = {name: reader.read(image) for name, reader in readers.items()}
        _count(run, found)
        run.noises.append(immerkaer_noise(image))
        for name, seen in found.items():
            run.times_ms[name].append(seen.time_ms)
        run.clean.append(found)
        run.noisy.append({name: reader.read(noisy) for name, reader in readers.items()})
        run.images = number + 1
        progress.update(image_set.name, run.images, None, f"{run.images} of {len(image_set.files)} or more")
    return run


def _count(run: _SetRun, found: dict[str, Sightings]) -> None:
    judged = judge(found, ids_repeat=run.image_set.model.ids_repeat)
    run.confirmed += len(judged.confirmed)
    for name in found:
        run.found[name] += sum(name in place.found_by for place in judged.confirmed)


def _measure_board(measured: Measurement, name: str, runs: list[_SetRun], reported: Sequence[str]) -> None:
    """Fit all sets of one board, estimate its errors, and add the rows of its sets."""
    corners = board_corners(runs[0].board, runs[0].image_set.dictionary)
    clean = {run.image_set.name: run.clean for run in runs}
    degrees = {run.image_set.name: run.board.degree for run in runs}
    chosen = choose_degrees(corners, clean) if None in degrees.values() else {}
    degrees_used = {key: degree or chosen[key] for key, degree in degrees.items()}
    fits = fit_images(corners, clean, degrees_used)
    noisy = fit_images(corners, {run.image_set.name: run.noisy for run in runs}, degrees_used)
    learned = learn_board_errors(fits, len(corners), sum(run.images for run in runs))
    measured.boards[name] = np.array(list(corners.values())), learned
    for run in runs:
        key = run.image_set.name
        mine = [one for one in fits if one.set_name == key]
        errors = _by_detector(mine, learned)
        shifts = _shifts(mine, [one for one in noisy if one.set_name == key])
        floors = find_floor(errors, shifts, float(np.median(run.noises)) ** 2 / ADDED_NOISE**2)
        kept = {detector: errors[detector] for detector in reported if detector in errors}
        measured.sets[key] = SetErrors(kept, floors)
        common = _common(run, kept)
        for detector in reported:
            if detector in run.times_ms:
                row = _row(run, detector, kept.get(detector), common, floors)
                measured.rows.append(row | {"degree": degrees_used[key]})


def _by_detector(fits: Sequence[Fitted], learned: BoardErrors) -> dict[str, MarkerErrors]:
    names = dict.fromkeys(one.detector for one in fits)
    found = {name: collect_errors([one for one in fits if one.detector == name], learned) for name in names}
    return {name: errors for name, errors in found.items() if errors is not None}


def _shifts(clean: Sequence[Fitted], noisy: Sequence[Fitted]) -> dict[str, MarkerErrors]:
    """Return the marker shifts by added noise for markers found both times, by detector."""
    shifts = {}
    noisy_fits = {(one.image, one.detector): one.fit for one in noisy}
    for name in dict.fromkeys(one.detector for one in clean):
        keys, moves, turns = [], [], []
        for one in clean:
            after = noisy_fits.get((one.image, name))
            if one.detector != name or after is None:
                continue
            _, first, second = np.intersect1d(one.fit.ids, after.ids, return_indices=True)
            before_px = one.fit.predicted_px[first] + one.fit.residuals_px[first]
            moved = after.predicted_px[second] + after.residuals_px[second] - before_px
            keys.append(np.column_stack([np.full(first.size, one.image), one.fit.ids[first]]))
            moves.append(moved)
            whole = np.zeros_like(one.fit.predicted_px)
            whole[first] = moved
            turns.append(turns_deg(one.fit, whole)[first])
        if keys:
            moved = np.concatenate(moves)
            shifts[name] = MarkerErrors(
                keys=np.concatenate(keys),
                center=moved.mean(axis=1),
                corner=moved.reshape(-1, 8),
                heading=np.concatenate(turns)[:, None],
                learned=dict.fromkeys(QUANTITIES, 0.0),
                covariances=np.zeros((len(moved), 3, 3)),
                outliers=0,
            )
    return shifts


def _common(run: _SetRun, errors: Mapping[str, MarkerErrors]) -> set[tuple[int, ...]]:
    """Return image and id of the markers that all detectors of high recall find."""
    able = [one for name, one in errors.items() if run.found[name] >= COMMON_RECALL * run.confirmed]
    return set.intersection(*({tuple(key) for key in one.keys.tolist()} for one in able)) if able else set()


def _row(
    run: _SetRun,
    name: str,
    errors: MarkerErrors | None,
    common: set[tuple[int, ...]],
    floors: Mapping[str, float | None],
) -> Row:
    times, reference = run.times_ms[name], run.times_ms.get(REFERENCE)
    return {
        "set": run.image_set.name,
        "board": run.board.name or run.image_set.name,
        "dictionary": run.image_set.dictionary,
        "detector": name,
        "images": run.images,
        "confirmed": run.confirmed,
        "found": run.found[name],
        "recall": run.found[name] / run.confirmed if run.confirmed else None,
        "markers": 0 if errors is None else len(errors.keys),
        "outliers": 0 if errors is None else errors.outliers,
        **_error_columns(errors, common, floors),
        "ms_median": float(np.median(times)),
        "times_reference": None if reference is None else float(np.median(np.divide(times, reference))),
    }


def _error_columns(
    errors: MarkerErrors | None, common: set[tuple[int, ...]], floors: Mapping[str, float | None]
) -> Row:
    """Return medians, their excess over the floor, 95th percentiles and NEES; None where unknown."""
    columns: Row = {}
    shared = None if errors is None else only(errors, common)
    for quantity in QUANTITIES:
        unit = "deg" if quantity == "heading" else "px"
        floor = floors[quantity]
        median_of_sigma = MEDIAN_PER_SIGMA if quantity == "heading" else RAYLEIGH_MEDIAN
        lowest = None if floor is None else median_of_sigma * floor
        median = None if errors is None else errors.median(quantity)
        beyond = None if median is None or lowest is None else max(median**2 - lowest**2, 0.0) ** 0.5
        columns |= {
            f"{quantity}_{unit}": median,
            f"{quantity}_floor_{unit}": lowest,
            f"{quantity}_beyond_floor_{unit}": beyond,
            f"{quantity}_p95_{unit}": None if errors is None else errors.percentile(quantity, 95.0),
            f"{quantity}_common_{unit}": shared.median(quantity) if shared and len(shared.keys) else None,
        }
        if quantity != "corner":
            columns[f"nees_{quantity}"] = None if errors is None else errors.nees(quantity, 0.0)
            columns[f"nees_{quantity}_with_floor"] = (
                None if errors is None or floor is None else errors.nees(quantity, floor)
            )
    return columns
