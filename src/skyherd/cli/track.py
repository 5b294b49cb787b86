"""`skyherd track`: robots followed through overhead recordings."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import complete_scenario
from skyherd.cli.console import ProgressReporter, say, say_table, warn
from skyherd.cli.interrupts import NOTHING_LEFT, telling_of_interrupts
from skyherd.cli.options import (
    BorderBits,
    Detector,
    Dictionary,
    ForceFolder,
    Inverted,
    MarkerSide,
    PoseCamera,
    Topic,
    metric_options,
)
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.tracking import GroundTracks


def track(
    videos: Annotated[
        list[Path],
        typer.Argument(
            metavar="VIDEO|BAG", help="Videos or rosbag2 recordings from above, such as flight.mp4."
        ),
    ],
    shape: Annotated[
        str | None,
        typer.Option(
            metavar="SHAPE",
            help="Compare with this shape: circle, grid, line, star, triangle, or a word such as word:SKY.",
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            metavar="SCENARIO",
            help="Compare with the shape, the robots and their markers of this scenario.",
            autocompletion=complete_scenario,
        ),
    ] = None,
    ids: Annotated[
        str | None,
        typer.Option(metavar="IDS", help="Follow only these markers, such as 0-15,20."),
    ] = None,
    marker_side_m: MarkerSide = None,
    camera: PoseCamera = None,
    topic: Topic = None,
    dictionary: Dictionary = "4X4_50",
    detector: Detector = "photometric",
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", show_default="tracks/NAME", help="Write the results into this new folder."
        ),
    ] = None,
    border_bits: BorderBits = 1,
    inverted: Inverted = False,
    force: ForceFolder = False,
) -> int:
    """Follow robots through overhead videos; measure their shape.

    It writes rectified tracks on the ground, in marker sides or metres, and the shape error over time, as
    tables and a figure. With a calibration it also writes the poses of the markers.

    Exit code 0 when done, 1 if no robot's marker was found, 2 for bad input.
    """
    from skyherd.datasets import refuse_configuration
    from skyherd.files.rosbag_reader import is_bag
    from skyherd.inspection import output_name
    from skyherd.markers.sheet_layout import parse_ids
    from skyherd.tracking import FIGURE, POSES, SHAPE, TRACKS, named_shape, scenario_shape, track_videos

    if shape is not None and scenario is not None:
        raise InputError("--shape", "given with --scenario", "one of the two")
    side_m, calibration = metric_options(marker_side_m, camera)
    for video in videos:
        if not is_bag(video):
            refuse_configuration(video, "video")
    source = None if shape is None else named_shape(shape)
    layout = None
    if scenario is not None:
        source, layout = scenario_shape(scenario)
    folder = out_dir or Path("tracks") / output_name(Path(os.path.abspath(videos[0])).stem)
    with ProgressReporter() as progress, telling_of_interrupts(NOTHING_LEFT):
        recordings = track_videos(
            videos,
            folder,
            shape=source,
            members=None if ids is None else parse_ids(ids, dictionary),
            side_m=side_m,
            calibration=calibration,
            layout=layout,
            topic=topic,
            detector=detector,
            dictionary=dictionary,
            border_bits=border_bits,
            inverted=inverted,
            force=force,
            progress=progress,
        )
    rows = [
        (
            tracks.name,
            str(len(tracks.sightings)),
            str(tracks.ids.size),
            str(sum(len(sighting.seen) for sighting in tracks.sightings)),
        )
        for tracks in recordings
    ]
    say_table(
        ("file", "frames", "markers", "sightings"), rows, right_aligned=("frames", "markers", "sightings")
    )
    for tracks in recordings:
        _warn_if_empty(tracks, ids)
        if source is not None and tracks.ids.size and max(len(one.seen) for one in tracks.sightings) < 3:
            warn(f"{tracks.name}: no shape error, which needs three robots in an image")
    tables = [TRACKS, *([SHAPE] if source else []), *([POSES] if calibration else [])]
    say(f"see {', '.join(str(folder / name) for name in (FIGURE, *tables))}")
    return 0 if any(tracks.ids.size for tracks in recordings) else 1


def _warn_if_empty(tracks: "GroundTracks", ids: str | None) -> None:
    """Warn of a recording in which no robot was seen, and say what was."""
    if not tracks.ids.size and tracks.strangers:
        seen = ", ".join(map(str, sorted(tracks.strangers)))
        warn(f"{tracks.name}: none of --ids {ids} was seen; seen were {seen}")
    elif not tracks.ids.size:
        warn(f"{tracks.name}: no marker found; `skyherd detect --explain` says why")
