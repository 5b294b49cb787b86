"""`skyherd ros2`: markers in the images of any camera, published for ROS 2 until the end is asked for."""

import re
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass

import numpy as np

from skyherd.errors import InputError
from skyherd.live.cameras import CameraReader, Frame, Origin, open_camera
from skyherd.live.ros2.camera_info import CameraInfoWatch
from skyherd.live.ros2.names import Place, split_address
from skyherd.live.ros2.publishing import MarkerPublisher, poses_of
from skyherd.messages import Detections
from skyherd.poses import Calibration
from skyherd.vision import DeferringDetector, create_detector

SCHEME, NAMESPACE = "ros2://", "skyherd"
"""Scheme of addresses, and the default prefix of the topics."""

NODE = "skyherd_markers"
"""Default name of the publishing node."""

KEPT = 30
"""Images that wait while others are measured. *Chosen*: one second at 30 images a second."""

WAIT_S = 0.1
"""Longest wait for an image before the end is checked, s. *Chosen*."""

NUMBERS = re.compile(r"[\d.]+")
"""Numbers in a problem, which do not make it a new one."""

MAX_LATENCIES = 100_000
"""Latencies of which the median is reported. *Chosen*: an hour at 30 images a second."""


@dataclass(frozen=True)
class BridgeSettings:
    """Settings of a bridge: its images and its output.

    Attributes:
        camera: address of the camera; see `open_camera`.
        to: address of the output, `ros2://host:7447/namespace`; None for the router of a `ros2://` camera, or
            for this machine.
        dictionary: the markers' dictionary.
        detector: name of the detector.
        side_m: side of the markers, for poses; None for none.
        calibration: of the camera; None for the `camera_info` beside the topic of a `ros2://` camera.
        one_plane: whether all markers lie on one plane.
        frame: coordinate frame of images that name none.
    """

    camera: str
    to: str | None = None
    dictionary: str = "4X4_50"
    detector: str = "tracking"
    side_m: float | None = None
    calibration: Calibration | None = None
    one_plane: bool = False
    frame: str = "camera"

    def output(self) -> tuple[Place, str]:
        """Return the place and the namespace of the output.

        Raises:
            InputError: the address is invalid.
        """
        if self.to is not None:
            return _split(self.to, "to")
        if not self.camera.startswith(SCHEME):
            return Place(node=NODE), NAMESPACE
        source, _ = self.source()
        return Place(source.host, source.port, source.domain, NODE, source.config), NAMESPACE

    def source(self) -> tuple[Place, str]:
        """Return the place and the topic of the images of a `ros2://` camera."""
        return _split(self.camera, f"camera {self.camera}")

    def check(self) -> None:
        """Refuse poses without a calibration.

        Raises:
            InputError: a side is given, and nothing calibrates the camera.
        """
        if self.side_m is not None and self.calibration is None and not self.camera.startswith(SCHEME):
            raise InputError(
                "side_m", "given without a calibration", "`calibration=` too, or a ros2:// camera"
            )


def _split(address: str, where: str) -> tuple[Place, str]:
    if not address.startswith(SCHEME):
        raise InputError(where, repr(address), "ros2://host:7447/namespace")
    try:
        place, name, _ = split_address(address, where, options=("type",), node=NODE)
    except ValueError as error:
        raise InputError(where, str(error), "ros2://host:7447/namespace") from None
    return place, name or NAMESPACE


class Bridge:
    """Measurement and publication of the markers of one camera.

    Args:
        settings: the settings.
        clock: returns the time of the camera's stamps, s.
        now_ns: returns the time since 1970, ns.

    Attributes:
        images: number of measured images.
        markers: number of published markers.
        latencies_s: times from the arrival of an image to the publication of its markers.

    Raises:
        InputError: a setting is invalid, the camera or the router does not answer, or a library is missing.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        *,
        clock: Callable[[], float] = time.monotonic,
        now_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        settings.check()
        self.images = self.markers = 0
        self.latencies_s: list[float] = []
        self._settings, self._clock, self._now_ns = settings, clock, now_ns
        self._detector = create_detector(settings.detector, dictionary=settings.dictionary, deferring=True)
        place, namespace = settings.output()
        self._infos: CameraInfoWatch | None = None
        self._problem: str | None = None
        with ExitStack() as stack:
            self._publisher = stack.enter_context(
                closing(MarkerPublisher(place, namespace, settings.to or settings.camera))
            )
            if settings.side_m is not None and settings.calibration is None:
                source, topic = settings.source()
                self._infos = stack.enter_context(closing(CameraInfoWatch(source, topic)))
            self._reader: CameraReader = stack.enter_context(
                open_camera(settings.camera, clock=clock, kept=KEPT)
            )
            self._stack = stack.pop_all()

    @property
    def dropped(self) -> int:
        """Number of images that arrived too fast, or out of order."""
        return self._reader.dropped

    def run(self, ended: Callable[[], bool], say: Callable[[str], object]) -> None:
        """Publish until `ended()`, or until the end of a recording. `say` gets each new problem."""
        told = ""
        while not (ended() or self._reader.ended):
            frame = self._reader.newest(WAIT_S)
            if frame is not None:
                self._handle(frame)
            problem = self._reader.trouble or self._problem or ""
            gist = NUMBERS.sub("", problem)
            if problem and gist != told:
                say(problem)
            told = gist

    def _handle(self, frame: Frame) -> None:
        """Publish the markers of an image, and look for further ones afterwards.

        Poses take longer than detections. Images that others already wait for get none.
        """
        origin = self._origin(frame)
        found = self._detector.detect(frame.image, time_s=frame.captured_s)
        self.images += 1
        self.markers += len(found)
        try:
            self._publisher.publish(origin, found, self._settings.dictionary)
            if len(self.latencies_s) < MAX_LATENCIES:
                self.latencies_s.append(self._clock() - frame.arrived_s)
            self._problem = None
            if self._settings.side_m is not None and len(found) and not self._reader.waiting:
                self._publish_poses(frame, origin, found, self._settings.side_m)
        except (InputError, OSError) as error:
            self._problem = str(error)
        if isinstance(self._detector, DeferringDetector):
            self._detector.look_around(frame.image)

    def _publish_poses(self, frame: Frame, origin: Origin, found: Detections, side_m: float) -> None:
        settings, infos = self._settings, self._infos
        calibration = settings.calibration if infos is None else infos.newest()
        if calibration is None:
            if infos is not None:
                self._problem = infos.trouble or f"no poses: no message on /{infos.name} yet"
            return
        poses = poses_of(
            frame.image, found, settings.dictionary, calibration, side_m, one_plane=settings.one_plane
        )
        self._publisher.publish_poses(origin, found, poses)

    def _origin(self, frame: Frame) -> Origin:
        """Return the header of a frame: its message's, or the time of its capture."""
        origin = frame.origin
        if origin is not None and origin.stamp_ns:
            return origin
        age_ns = round((self._clock() - frame.captured_s) * 1e9)
        return Origin(self._now_ns() - age_ns, self._settings.frame if origin is None else origin.frame)

    def summary(self) -> str:
        """Return the number of images and markers and the latency, in one line."""
        latency = f", {1000 * np.median(self.latencies_s):.0f} ms an image (median)" if self.images else ""
        return f"{self.images} images, {self.markers} markers, {self.dropped} images dropped{latency}"

    def close(self) -> None:
        """Close the camera, and withdraw the topics."""
        self._stack.close()
