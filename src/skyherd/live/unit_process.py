"""Process of a unit: images in, goals for its robots out."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skyherd.errors import InputError
from skyherd.live.cameras import CameraReader, Frame, MirrorWatch, open_camera
from skyherd.live.cockpit import PREVIEWS, PreviewWriter
from skyherd.live.drivers import WORLD, open_driver
from skyherd.live.lab import Lab
from skyherd.live.logs.frame_log import FrameLog, Sight
from skyherd.live.logs.marker_poses import PoseMeter
from skyherd.live.logs.process_log import ProcessLog
from skyherd.live.logs.view import View, view_of
from skyherd.live.mailbox import Mailbox
from skyherd.live.process_context import HeartbeatTimer, ProcessContext, StatusLine
from skyherd.live.unit_core import UnitCore, UnitNews
from skyherd.messages import Detections, FlightCommand
from skyherd.vision import DeferringDetector, Detector, create_detector

HEARS = ("report/**", "heartbeat/**", "arm/**", "stop/**")
"""Topics that a unit listens to, after the team's name."""

NEWEST_S = 0.02
"""Longest wait for an image before messages are processed, s. Chosen: a fraction of the frame interval."""


def run_unit(
    context: ProcessContext,
    unit: int,
    *,
    address: str | None = None,
    previews: bool = False,
) -> None:
    """Run one unit until `context.ended()`, or until the end of a recorded video.

    Args:
        context: resources of the process.
        unit: its number.
        address: address of a camera instead of the lab's.
        previews: write pictures for the page of the run into the folder of the recordings.

    Raises:
        InputError: the camera's calibration or the detector cannot be used.
    """
    lab = context.lab
    camera, core = lab.camera(unit), lab.make_unit(unit)
    mailbox = context.mailbox(core.name, HEARS, lambda: core.latch)
    dictionary = lab.model.markers.dictionary
    meter = _pose_meter(lab, unit)
    detector = create_detector(camera.detector, dictionary=dictionary, deferring=True)
    with ExitStack() as stack:
        process_log = stack.enter_context(context.process_log(core.name))
        status = StatusLine(context, process_log)
        reader = _open(context, status, camera.address if address is None else address)
        if reader is None:
            return
        stack.enter_context(reader)
        pictures = lab.model.recording
        side_m = lab.model.markers.side_m
        frame_log = stack.enter_context(
            FrameLog(unit, pictures.image_rate_hz, pictures.image_width_px, side_m, meter)
        )
        preview = stack.enter_context(PreviewWriter(context.folder / PREVIEWS if previews else None, unit))
        autopilot = _autopilot(context, mailbox, stack, unit)
        at_work = UnitAtWork(
            context, core, mailbox, reader, detector, autopilot, process_log, frame_log, preview, status
        )
        while not (context.ended() or reader.ended):
            frame = reader.newest(NEWEST_S)
            at_work.listen()
            trouble = reader.trouble
            if frame is not None:
                trouble = at_work.look(frame, trouble)
            at_work.report(trouble)
            if frame is not None:
                at_work.look_around(frame)
        process_log.put("/end", context.clock(), {})


@dataclass(frozen=True)
class Autopilot:
    """Autopilot of a unit.

    Attributes:
        fly: called with each flight command.
        trouble: returns the reason why its link takes no commands now, or None.
    """

    fly: Callable[[FlightCommand], object]
    trouble: Callable[[], str | None] = lambda: None


@dataclass
class UnitAtWork:
    """Steps of a unit's cycle: receive messages, process the newest image, report, search the rest.

    Attributes:
        context: resources of the process.
        core: makes the decisions.
        mailbox: its messages.
        reader: reader of its camera.
        detector: marker detector.
        autopilot: its autopilot.
        process_log: its recording.
        frame_log: makes the preview images of the recording.
        preview: writes pictures for the page of the run.
        status: its status line.
    """

    context: ProcessContext
    core: UnitCore
    mailbox: Mailbox
    reader: CameraReader
    detector: Detector
    autopilot: Autopilot
    process_log: ProcessLog
    frame_log: FrameLog
    preview: PreviewWriter
    status: StatusLine
    _heartbeat_timer: HeartbeatTimer = field(default_factory=HeartbeatTimer, init=False)
    _state: str = field(default="no image yet", init=False)

    def __post_init__(self) -> None:
        self._mirrored = MirrorWatch(self.context.lab.model.markers.dictionary, self.context.clock)

    def listen(self) -> None:
        """Process the messages received by radio."""
        for arrival in self.mailbox.fetch():
            self.process_log.heard(arrival)
            self.core.receive(arrival.envelope, arrival.received_s)

    def look(self, frame: Frame, trouble: str | None) -> str | None:
        """Detect the markers in an image, and decide on them unless the image is faulty.

        Args:
            frame: the image.
            trouble: the camera fault that the reader reports, or None.

        Returns:
            The fault of the image, or None.
        """
        clock = self.context.clock
        begun_s = clock()
        markers = self.detector.detect(frame.image, time_s=frame.captured_s, unit_id=self.core.unit_id)
        trouble = trouble or self._mirrored.look(frame, markers)
        detections = self.context.lab.robots_of(markers, frame.image)
        found_s = clock()
        news, view = (None, None) if trouble else self._decide(frame, detections, begun_s, found_s)
        decision = None if news is None else news.decision
        self.frame_log.show(Sight(frame.image, markers, detections, decision, view))
        self.preview.show(frame.image, detections, view, trouble)
        self._state = _described(detections, view)
        return trouble

    def look_around(self, frame: Frame) -> None:
        """Search the image for further markers, after the decision on it was sent."""
        if isinstance(self.detector, DeferringDetector):
            self.detector.look_around(frame.image, unit_id=self.core.unit_id)

    def _decide(
        self, frame: Frame, detections: Detections, begun_s: float, found_s: float
    ) -> tuple[UnitNews | None, View | None]:
        """Decide on detections, send the messages, and then record all. Recording adds no latency."""
        news = self.core.see(detections, found_s)
        for message in () if news is None else news.messages:
            self.mailbox.send(message)
        sent_s = self.context.clock()
        view = None
        if news is not None:
            self.autopilot.fly(news.decision.flight)
            view = view_of(news.decision, self.context.lab.template)
        stages = {
            "captured_s": frame.captured_s,
            "arrived_s": frame.arrived_s,
            "begun_s": begun_s,
            "found_s": found_s,
            "sent_s": sent_s,
            "stamped_by": frame.stamped_by,
            "number": frame.number,
            "dropped": self.reader.dropped,
        }
        keep_image(self.process_log, detections, news, view, stages)
        return news, view

    def report(self, trouble: str | None) -> None:
        """Report faults, record finished preview images, and send a heartbeat when it is due."""
        now_s = self.context.clock()
        troubles = (
            trouble or self.core.trouble,
            self.core.withheld(now_s),
            self.autopilot.trouble(),
            self.frame_log.trouble,
            self.process_log.trouble,
        )
        problem = "; ".join(filter(None, troubles))
        self.status.say(f"{self.core.name}: {problem}" if problem else "")
        for topic, record in self.frame_log.done():
            self.process_log.keep(topic, now_s, record)
        if self._heartbeat_timer.due(now_s):
            self.mailbox.send(self.core.heartbeat(now_s, "; ".join(filter(None, (problem, self._state)))))
            counts = {"refused": self.mailbox.refusals.counts, "dropped": self.mailbox.dropped}
            self.process_log.put("/heartbeat", now_s, counts)


def keep_image(
    process_log: ProcessLog,
    detections: Detections,
    news: UnitNews | None,
    view: View | None,
    stages: dict[str, Any],
) -> None:
    """Record an image's detections, messages and stages, after the messages were sent."""
    process_log.saw(detections, stages["found_s"])
    process_log.put("/sent", stages["sent_s"], {"messages": None if news is None else news.messages})
    if view is not None:
        process_log.keep("/view", stages["sent_s"], view)
    process_log.put("/stages", stages["sent_s"], stages)


def _described(detections: Detections, view: View | None) -> str:
    """Return the state of a unit after its newest image, as a status text."""
    error = np.nan if view is None else view.shape_error
    known = f", shape error {100 * error:.2g} %" if np.isfinite(error) else ""
    return f"{len(detections)} markers{known}"


def _pose_meter(lab: Lab, unit: int) -> PoseMeter | None:
    """Return the measurement of poses of a unit's markers; None for a camera without calibration."""
    calibration, markers = lab.calibration(unit), lab.model.markers
    if calibration is None:
        return None
    flat = lab.layout is None or lab.layout.is_flat
    return PoseMeter(calibration, markers.side_m, markers.dictionary, one_plane=flat)


def _open(context: ProcessContext, status: StatusLine, address: str) -> CameraReader | None:
    """Open the camera, and wait until a stream is available. Return None if the process ends before."""
    while not context.ended():
        try:
            return open_camera(address, clock=context.clock)
        except InputError as error:
            if "://" not in address:
                raise
            status.say(f"waiting for its camera: {error}")
            time.sleep(0.5)
    return None


def _autopilot(context: ProcessContext, mailbox: Mailbox, stack: ExitStack, unit: int) -> Autopilot:
    """Return the autopilot of a unit, which sends its flight commands."""
    address = context.lab.camera(unit).driver
    if address is None or context.dry_run:
        return Autopilot(lambda command: None)
    if address == WORLD:
        return Autopilot(mailbox.send)
    limits = context.lab.speed_limits
    driver = stack.enter_context(open_driver(address, robot_id=unit, limits=limits, flies=True))
    return Autopilot(driver.send_flight, lambda: driver.trouble)
