"""`skyherd ros2`: markers of a camera as messages of ROS 2."""

from typing import Annotated

import typer

from skyherd.cli.console import say, warn
from skyherd.cli.interrupts import signals_as_requests
from skyherd.cli.options import Detector, Dictionary, Duration


def ros2(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE", help="Address of the camera, such as ros2://127.0.0.1/camera/image_raw."
        ),
    ],
    to: Annotated[
        str | None,
        typer.Option(
            "--to",
            metavar="ADDRESS",
            show_default="the router of a ros2:// camera, namespace skyherd",
            help="Router and namespace of the output, as ros2://127.0.0.1:7447/skyherd.",
        ),
    ] = None,
    dictionary: Dictionary = "4X4_50",
    detector: Detector = "tracking",
    marker_side_m: Annotated[
        float | None,
        typer.Option(
            "--marker-side-m",
            metavar="M",
            show_default=False,
            help="Side of the markers' black square; publishes poses. It needs a calibration.",
        ),
    ] = None,
    calibration_file: Annotated[
        str | None,
        typer.Option(
            "--camera",
            metavar="FILE[#NAME]",
            show_default="the camera_info beside a ros2:// topic",
            help="Calibration of the camera (OpenCV, ROS, Kalibr, caliscope).",
        ),
    ] = None,
    one_plane: Annotated[
        bool, typer.Option("--one-plane", help="All markers lie on one plane; makes poses more accurate.")
    ] = False,
    frame: Annotated[
        str, typer.Option(metavar="NAME", help="Coordinate frame of images that name none.")
    ] = "camera",
    duration_s: Duration = None,
) -> int:
    """Publish the markers that a camera sees, for ROS 2 over Zenoh, until Ctrl-C. It needs no ROS."""
    import time
    from contextlib import closing

    from skyherd.live.ros2.bridge import Bridge, BridgeSettings
    from skyherd.poses import check_side, read_calibration

    settings = BridgeSettings(
        source,
        to,
        dictionary=dictionary,
        detector=detector,
        side_m=None if marker_side_m is None else check_side("--marker-side-m", marker_side_m),
        calibration=None if calibration_file is None else read_calibration(calibration_file),
        one_plane=one_plane,
        frame=frame,
    )
    with signals_as_requests() as request, closing(Bridge(settings)) as bridge:
        place, namespace = settings.output()
        say(f"publishing /{namespace}/detections at {place.host}:{place.port}, domain {place.domain}")
        ends_s = float("inf") if duration_s is None else time.monotonic() + duration_s
        bridge.run(
            lambda: request.is_asked() or time.monotonic() >= ends_s,
            warn,
        )
        say(bridge.summary())
    return request.exit_code
