"""Options that several verbs have, with one name, one meaning and one help text each."""

from typing import TYPE_CHECKING, Annotated

import typer

from skyherd.cli.choices import (
    DETECTORS,
    PERCEPTIONS,
    complete_detector,
    complete_dictionary,
    complete_perception,
    complete_scenario,
)
from skyherd.cli.usage import only_known
from skyherd.errors import InputError

if TYPE_CHECKING:
    from skyherd.poses import Calibration

Scenario = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A built-in scenario, such as star, or a TOML file.",
        autocompletion=complete_scenario,
    ),
]

Perception = Annotated[
    str | None,
    typer.Option(
        metavar="KIND",
        help="How markers are detected: rendered (in drawn images), ideal (exactly), or noisy (exactly, "
        "with the detector's measured noise).",
        autocompletion=complete_perception,
        callback=only_known(PERCEPTIONS),
    ),
]

Jobs = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Use this many processes instead of one for each core."),
]

Duration = Annotated[
    float | None,
    typer.Option("--duration", metavar="SECONDS", min=0, help="End after this time."),
]

Dictionary = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Dictionary of the markers, such as APRILTAG_36h11 or DICT_4X4_50. `skyherd markers --help` "
        "lists them.",
        autocompletion=complete_dictionary,
    ),
]

Detector = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help=f"Detector to use: {', '.join(DETECTORS)}, or module:factory.",
        autocompletion=complete_detector,
    ),
]

BorderBits = Annotated[
    int,
    typer.Option(
        "--border-bits", metavar="N", min=1, max=3, help="Width of the markers' black border, in cells."
    ),
]

Inverted = Annotated[bool, typer.Option("--inverted", help="Look for markers that are white on black.")]

MarkerSide = Annotated[
    float | None,
    typer.Option(
        "--marker-side-m",
        metavar="M",
        show_default=False,
        help="Side of the markers' black square; gives positions on the ground in metres.",
    ),
]

PoseCamera = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="FILE[#NAME]",
        show_default=False,
        help="Calibration of the camera (OpenCV, ROS, Kalibr, caliscope); gives poses in its axes.",
    ),
]

Topic = Annotated[
    str | None,
    typer.Option(
        "--topic",
        metavar="NAME",
        show_default=False,
        help="Topic of the images, for a rosbag2 recording with several.",
    ),
]

ScenarioSettings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value of the scenario, such as control.k=0.2. It may be given several times.",
    ),
]

ForceFolder = Annotated[
    bool,
    typer.Option(
        "--force", help="Write into an existing folder. Only files of an earlier call are replaced."
    ),
]

ForceFile = Annotated[bool, typer.Option("--force", help="Replace a file of an earlier call.")]

DEFAULT_PORT = 8440
"""Port of a page. Chosen: not used by other common programs."""

LOOPBACK = "127.0.0.1"
"""Address at which only this computer can connect."""

PagePort = Annotated[
    int, typer.Option(metavar="N", min=0, max=65535, help="Port of the page; 0 for any free one.")
]

PageHost = Annotated[
    str,
    typer.Option(metavar="ADDRESS", help="Address of the page; 127.0.0.1 is for this computer only."),
]


def metric_options(
    marker_side_m: float | None, camera: str | None
) -> tuple[float | None, "Calibration | None"]:
    """Return the side, m, and the calibration; import `skyherd.poses` only if metres are asked for.

    Raises:
        InputError: the side is invalid or missing, or the calibration cannot be read.
    """
    if marker_side_m is None and camera is None:
        return None, None
    if marker_side_m is None:
        raise InputError(
            "--camera", "given without --marker-side-m", "both: the side is the scale of the poses"
        )
    from skyherd.poses import check_side, read_calibration

    side_m = check_side("--marker-side-m", marker_side_m)
    return side_m, None if camera is None else read_calibration(camera)
