"""`skyherd track`: robots followed through overhead recordings."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import DETECTORS, complete_detector, complete_dictionary
from skyherd.cli.console import ProgressReporter, say, say_table, warn
from skyherd.cli.interrupts import telling_of_interrupts
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.tracking import GroundTracks


def track(
    videos: Annotated[list[Path], typer.Argument(metavar="VIDEO...", help="Recordings from above.")],
    shape: Annotated[
        str | None,
        typer.Option(help="Shape to compare with, such as circle or word:SKY."),
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(help="Scenario, or its file, whose shape and robots to compare with.")
    ] = None,
    ids: Annotated[
        str | None, typer.Option(help="The robots' markers, such as 0-15,20; all that are seen if left out.")
    ] = None,
    dictionary: Annotated[
        str,
        typer.Option(help="Marker dictionary, such as APRILTAG_36h11.", autocompletion=complete_dictionary),
    ] = "4X4_50",
    detector: Annotated[
        str, typer.Option(help=f"One of {', '.join(DETECTORS)}.", autocompletion=complete_detector)
    ] = "photometric",
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Folder to make; tracks/NAME if left out.")
    ] = None,
    border_bits: Annotated[
        int, typer.Option("--border-bits", min=1, max=3, help="Cells of the markers' black border.")
    ] = 1,
    inverted: Annotated[bool, typer.Option("--inverted", help="Markers are white on black.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write into an existing folder.")] = False,
) -> int:
    """Follow robots with markers through overhead recordings, and measure the shape that they form.

    Leaves tracks on the ground in marker sides, rectified, and the shape error over time, as tables and a
    figure. Exit code 0 when done, 1 if no robot's marker was found, 2 for bad input.
    """
    from skyherd.inspection import output_name
    from skyherd.markers.sheet_layout import parse_ids
    from skyherd.tracking import FIGURE, SHAPE, TRACKS, named_shape, scenario_shape, track_videos

    if shape is not None and scenario is not None:
        raise InputError("--shape", "given with --scenario", "one of the two")
    source = None if shape is None else named_shape(shape)
    source = source if scenario is None else scenario_shape(scenario)
    folder = out_dir or Path("tracks") / output_name(Path(os.path.abspath(videos[0])).stem)
    with ProgressReporter() as progress, telling_of_interrupts("nothing is left of it"):
        recordings = track_videos(
            videos,
            folder,
            shape=source,
            members=None if ids is None else parse_ids(ids, dictionary),
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
    tables = f"{folder / TRACKS}" + (f", {folder / SHAPE}" if source else "")
    say(f"see {folder / FIGURE}, {tables}")
    return 0 if any(tracks.ids.size for tracks in recordings) else 1


def _warn_if_empty(tracks: "GroundTracks", ids: str | None) -> None:
    """Warn of a recording in which no robot was seen, and say what was."""
    if not tracks.ids.size and tracks.strangers:
        seen = ", ".join(map(str, sorted(tracks.strangers)))
        warn(f"{tracks.name}: none of --ids {ids} was seen; seen were {seen}")
    elif not tracks.ids.size:
        warn(f"{tracks.name}: no marker found; `skyherd detect --explain` says why")
