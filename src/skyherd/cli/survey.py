"""`skyherd survey`: markers and cameras in one frame, in metres."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.console import ProgressReporter, say, say_table, warn
from skyherd.cli.interrupts import NOTHING_LEFT, telling_of_interrupts
from skyherd.cli.options import BorderBits, Detector, Dictionary, ForceFolder, Inverted, Topic

if TYPE_CHECKING:
    from skyherd.survey import Survey


def survey(
    pictures: Annotated[
        list[Path],
        typer.Argument(
            metavar="PICTURE|VIDEO|BAG",
            help="Pictures and recordings of the same markers, such as a.jpg b.jpg.",
        ),
    ],
    marker_side_m: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="Side of the markers' black square, such as 0.12.",
            show_default=False,
        ),
    ],
    camera: Annotated[
        list[str],
        typer.Option(
            metavar="FILE[#NAME]",
            help="Calibration (OpenCV, ROS, Kalibr, caliscope), such as camera.yaml: once for all pictures, "
            "or once for each.",
            show_default=False,
        ),
    ],
    reference: Annotated[
        int | None,
        typer.Option(
            metavar="ID", min=0, help="Marker whose axes are those of the frame.", show_default=False
        ),
    ] = None,
    fixed: Annotated[
        str | None,
        typer.Option(
            metavar="IDS",
            help="Markers that stand still, such as 0-3,20; others move between the pictures.",
            show_default="all",
        ),
    ] = None,
    one_plane: Annotated[
        bool, typer.Option("--one-plane", help="The markers of the frame lie on one plane.")
    ] = False,
    layout: Annotated[
        bool,
        typer.Option(
            "--layout", help="Print the frame's markers as the layout of one robot, for TOML files."
        ),
    ] = False,
    frames: Annotated[
        int,
        typer.Option("--images", metavar="N", min=1, max=500, help="Take this many images of a recording."),
    ] = 20,
    topic: Topic = None,
    dictionary: Dictionary = "4X4_50",
    detector: Detector = "photometric",
    out_dir: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            show_default="surveys/NAME",
            help="Write the results into this new folder.",
        ),
    ] = None,
    border_bits: BorderBits = 1,
    inverted: Inverted = False,
    force: ForceFolder = False,
) -> int:
    """Measure where markers and calibrated cameras are, in one frame.

    Markers that several pictures share connect them. With --fixed, a moving camera and moving robots are
    located in the frame of markers that stand still. With --fixed and --layout, the markers of one robot are
    the frame, and the robot may stand anywhere.

    Exit code 0 when done, 1 if the pictures contradict each other, 2 for bad input.
    """
    from skyherd.inspection import output_name
    from skyherd.markers.sheet_layout import parse_ids
    from skyherd.poses import check_side
    from skyherd.survey import (
        CAMERAS,
        FRAME,
        MARKERS,
        PLAN,
        layout_text,
        output_folder,
        take_views,
        write_survey,
    )
    from skyherd.survey import survey as measure

    side_m = check_side("--marker-side-m", marker_side_m)
    members = None if fixed is None else parse_ids(fixed, dictionary, "--fixed")
    folder = out_dir or Path("surveys") / output_name(Path(os.path.abspath(pictures[0])).stem)
    output_folder(folder, inputs=pictures, force=force).check()
    with ProgressReporter() as progress, telling_of_interrupts(NOTHING_LEFT):
        views = take_views(
            pictures,
            camera,
            dictionary=dictionary,
            detector=detector,
            border_bits=border_bits,
            inverted=inverted,
            frames=frames,
            topic=topic,
            fixed=members,
            progress=progress,
        )
        found = measure(views, side_m, reference=reference, fixed=members, coplanar=one_plane)
        text = layout_text(found) if layout else None
        write_survey(found, folder, inputs=pictures, force=force)
    _say_cameras(found)
    if text is not None:
        for line in text.splitlines():
            say(line)
    names = ", ".join(str(folder / name) for name in (MARKERS, CAMERAS, FRAME))
    say(f"see {folder / PLAN}, {names}")
    if found.is_consistent:
        if found.variance_factor > 1:
            times = found.variance_factor**0.5
            say(f"errors are {times:.2g} times those of image noise; the standard deviations contain this")
        return 0
    warn(
        f"{folder}: {_contradiction(len(found.cameras), has_fixed=members is not None)} "
        f"(chi-squared {found.frame.chi_squared:.3g} at {found.frame.freedoms} degrees of freedom)"
    )
    return 1


def _contradiction(pictures: int, *, has_fixed: bool) -> str:
    """Return which pictures contradict which assumption, and what to do."""
    if pictures == 1:
        return (
            "the picture contradicts equal sides on one camera: --marker-side-m or the calibration is wrong"
        )
    if has_fixed:
        return (
            "the pictures contradict each other: a marker of --fixed moved, or a side or calibration is wrong"
        )
    which = "name the markers that stand still with --fixed"
    return f"the pictures contradict each other: a marker moved, or a side or calibration is wrong; {which}"


def _say_cameras(found: "Survey") -> None:
    """Print the place of each camera with its largest standard deviation."""
    rows = []
    for one in found.cameras:
        x, y, z = (f"{value:.4f}" for value in one.position_m)
        std_mm = 1000 * float(one.covariance.diagonal()[:3].max()) ** 0.5
        rows.append((one.view, x, y, z, f"{std_mm:.1f}"))
    say_table(
        ("picture", "x, m", "y, m", "z, m", "std, mm"),
        rows,
        right_aligned=("x, m", "y, m", "z, m", "std, mm"),
    )
