"""Tracking of videos: tables of tracks, poses and shape errors, and a figure."""

import csv
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.errors import InputError
from skyherd.files.atomic import whole_file, write_whole
from skyherd.files.image_streams import is_stream, open_stream, read_stream
from skyherd.files.output_folder import OutputFolder
from skyherd.files.video_reader import Clip
from skyherd.geometry import Image
from skyherd.inspection import Place, detection_rows, open_table
from skyherd.inspection.metres import POSE_COLUMNS, MetricColumns
from skyherd.inspection.table import WHERE
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import Detections
from skyherd.poses import Calibration, check_side
from skyherd.text import table_cell
from skyherd.tracking.figure import draw_tracks
from skyherd.tracking.ground_tracks import GroundTracks, ShapeErrors, Sighting, shape_errors
from skyherd.tracking.shapes import ShapeSource
from skyherd.vision import DEFAULT_DICTIONARY, Detector, create_detector, fuse_markers

VERB = "track"
"""Verb in the record of output folders for the files made here."""

TRACKS = "tracks.csv"
"""Name of the table of tracks."""

SHAPE = "shape.csv"
"""Name of the table of shape errors."""

POSES = "poses.csv"
"""Name of the table of poses in the camera's axes."""

FIGURE = "tracks.png"
"""Name of the figure."""

TRACK_COLUMNS = (
    *("file", "frame", "time_s", "id", "x_sides", "y_sides", "heading_deg"),
    *("u_px", "v_px", "side_px", "std_u_px", "std_v_px"),
)
"""Columns of the tracks: on the ground, and as detected in the image. Standard deviations are empty if the
detector does not provide them. With a marker side in metres, x and y are named as in `METRE_COLUMNS`."""

METRE_COLUMNS = {"x_sides": "x_m", "y_sides": "y_m"}
"""Names of the columns of positions in metres, by those in marker sides."""

METRE_STDS = ("std_x_m", "std_y_m")
"""Columns of the standard deviations in metres, which come last."""

SHAPE_COLUMNS = ("file", "frame", "time_s", "robots", "shape_error")
"""Columns of the shape errors: robots of the shape in the image, and error, empty for fewer than three."""

AddPoses = Callable[[Place, Image, Detections], None]
"""Function that writes the poses of the markers in an image."""


def track_videos(
    videos: Sequence[Path],
    folder: Path,
    *,
    shape: ShapeSource | None = None,
    members: Collection[int] | None = None,
    side_m: float | None = None,
    calibration: Calibration | None = None,
    layout: MarkerLayout | None = None,
    topic: str | None = None,
    detector: str = "photometric",
    dictionary: str = DEFAULT_DICTIONARY,
    border_bits: int = 1,
    inverted: bool = False,
    force: bool = False,
    progress: Progress = NO_PROGRESS,
) -> list[GroundTracks]:
    """Track the markers in videos, each independently, and write tables and a figure into a folder.

    Args:
        videos: the recordings: videos, or rosbag2 recordings.
        folder: the output folder.
        shape: the shape for comparison, for the markers of all videos together; None for none.
        members: the robots, if other markers are in view as well; None for all markers.
        side_m: side of the markers, m, for positions in metres; None for positions in marker sides.
        calibration: of the camera of all videos, for poses in its axes; needs `side_m`. All markers count as
            lying on one plane, unless the layout has heights. None for no poses.
        layout: markers on the robots; None for one on each.
        topic: topic of the images in rosbag2 recordings; None for the only one of each.
        detector: name or `module:factory`; each video gets a new detector.
        dictionary: dictionary of the markers.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.
        force: True to allow an existing folder. Only files of an earlier tracking are removed from it.
        progress: receives the number of processed images of each video.

    Returns:
        The tracks of each video.

    Raises:
        InputError: a video cannot be read or has not the calibrated size, the folder exists, the shape does
            not fit these robots, or a calibration is given without a side.
        OutputError: a file cannot be written.
    """
    if side_m is not None:
        check_side("side_m", side_m)
    elif calibration is not None:
        raise InputError("calibration", "given without side_m", "both: the side is the scale of the poses")
    for video in videos:
        if not is_stream(video):
            allowed = "an .mp4, .mkv, .avi, .mov or .webm file, or a rosbag2 recording"
            raise InputError(str(video), "not a video by its name", allowed)
        open_stream(video, topic)
    settings: dict[str, Any] = dict(dictionary=dictionary, border_bits=border_bits, inverted=inverted)
    create_detector(detector, **settings)
    names = [TRACKS, FIGURE, *([SHAPE] if shape else []), *([POSES] if calibration else [])]
    with OutputFolder(folder, VERB, names, force=force, inputs=videos):
        fuse = _fuser(layout, settings)
        robots = None if members is None else frozenset(members)
        recordings = []
        with _pose_table(folder / POSES, side_m, calibration, robots, layout, settings) as add_poses:
            for video in videos:
                tracks = GroundTracks(video.name, robots, side_m)
                eyes = create_detector(detector, **settings)
                _follow(tracks, open_stream(video, topic), eyes, fuse, add_poses, progress)
                recordings.append(tracks)
        with _table(folder / TRACKS, _columns(side_m)) as table:
            table.writerows(row for tracks in recordings for row in _track_rows(tracks))
        errors = _errors(recordings, shape)
        if shape:
            with _table(folder / SHAPE, SHAPE_COLUMNS) as table:
                for tracks, error in zip(recordings, errors, strict=bool(errors)):
                    table.writerows(_shape_rows(tracks, error))
        figure = draw_tracks(recordings, errors)
        write_whole(folder / FIGURE, lambda part: figure.savefig(part, format="png"))
    return recordings


def _columns(side_m: float | None) -> list[str]:
    """Return the columns of the tracks, in marker sides or in metres."""
    if side_m is None:
        return [*TRACK_COLUMNS]
    return [*(METRE_COLUMNS.get(name, name) for name in TRACK_COLUMNS), *METRE_STDS]


def _fuser(
    layout: MarkerLayout | None, settings: dict[str, Any]
) -> Callable[[Detections, Image], Detections]:
    """Return the function from the markers in an image to the robots."""
    if layout is None:
        return lambda found, _: found
    return lambda found, image: fuse_markers(found, layout, image, **settings)


def _follow(
    tracks: GroundTracks,
    clip: Clip,
    detector: Detector,
    fuse: Callable[[Detections, Image], Detections],
    add_poses: AddPoses,
    progress: Progress,
) -> None:
    """Add all images of a recording to tracks, and their poses to the table."""
    for frame in read_stream(clip):
        found = detector.detect(frame.image, time_s=frame.time_s)
        add_poses(Place(clip.path.name, frame.index, frame.time_s), frame.image, found)
        tracks.add(frame.index, fuse(found, frame.image))
        done = frame.index + 1
        progress.update(clip.path.name, done, max(clip.count, done) if clip.count else None)


@contextmanager
def _pose_table(
    path: Path,
    side_m: float | None,
    calibration: Calibration | None,
    robots: frozenset[int] | None,
    layout: MarkerLayout | None,
    settings: dict[str, Any],
) -> Iterator[AddPoses]:
    """Open the table of poses, and yield the function that adds an image to it; see `track_videos`."""
    if side_m is None or calibration is None:
        yield lambda place, image, found: None
        return
    columns = MetricColumns(
        side_m,
        calibration,
        one_plane=layout is None or layout.is_flat,
        border_bits=settings["border_bits"],
        inverted=settings["inverted"],
    )
    with open_table(path, [*WHERE, "id", *POSE_COLUMNS], "csv") as table:

        def add(place: Place, image: Image, found: Detections) -> None:
            found = found.unambiguous()
            if robots is not None:
                owners = found.ids if layout is None else layout.robots_of(found.ids)
                found = found[np.isin(owners, list(robots))]
            poses = columns.rows(place.file, image, found, settings["dictionary"])
            for row in detection_rows(place, found, poses):
                table.add(row)

        yield add


def _errors(recordings: Sequence[GroundTracks], shape: ShapeSource | None) -> list[ShapeErrors]:
    """Return the shape errors of each recording; none without a shape, or without robots."""
    ids = np.unique(np.concatenate([tracks.ids for tracks in recordings]))
    if shape is None or ids.size == 0:
        return []
    template = shape(ids)
    return [shape_errors(tracks, template) for tracks in recordings]


@contextmanager
def _table(path: Path, columns: Sequence[str]) -> Iterator[Any]:
    """Open a writer of a CSV file, which gets its name when it is complete."""
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        yield writer


def _track_rows(tracks: GroundTracks) -> Iterator[list[Any]]:
    for sighting in tracks.sightings:
        for row in range(len(sighting.seen)):
            cells = _cells(sighting, row)
            if tracks.side_m is not None:
                stds_m = np.sqrt(np.diag(sighting.covariances[row]))
                cells += [f"{value:.6f}" if value else "" for value in stds_m]
            yield [table_cell(tracks.name), sighting.index, f"{sighting.time_s:.4f}", *cells]


def _cells(sighting: Sighting, row: int) -> list[Any]:
    """Return the cells of one marker in one image: id, position and heading on the ground, and detection."""
    seen = sighting.seen
    covariance = seen.covariances[row]
    stds = np.sqrt(np.diag(covariance)[:2]) if covariance.any() else ()
    ground = [*sighting.positions[row], np.degrees(np.angle(np.exp(1j * sighting.headings_rad[row])))]
    return [
        int(seen.ids[row]),
        *(f"{value:.5f}" for value in ground),
        *(f"{value:.3f}" for value in (*seen.centers_px[row], seen.sides_px[row])),
        *([f"{value:.4f}" for value in stds] or ["", ""]),
    ]


def _shape_rows(tracks: GroundTracks, error: ShapeErrors) -> Iterator[list[Any]]:
    for sighting, value, count in zip(tracks.sightings, error.errors, error.counts, strict=True):
        told = f"{value:.6f}" if np.isfinite(value) else ""
        yield [table_cell(tracks.name), sighting.index, f"{sighting.time_s:.4f}", int(count), told]
