"""A unit's process: images in, goals for its robots out."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skyherd.errors import InputError
from skyherd.live.cameras import CameraReader, Frame, MirrorWatch, open_camera
from skyherd.live.diaries.album import Album
from skyherd.live.diaries.diary import Diary
from skyherd.live.diaries.view import View, view_of
from skyherd.live.drivers import WORLD, open_driver
from skyherd.live.radio import Post
from skyherd.live.station import Beats, Station, Told
from skyherd.live.unit_core import UnitCore, UnitNews
from skyherd.messages import Detections, FlightCommand
from skyherd.vision import DeferringDetector, Detector, create_detector, warm_up

HEARS = ("report/**", "beat/**", "stop/**")
"""Topics that a unit listens to, after the team's name."""

NEWEST_S = 0.02
"""Longest wait for an image before messages are looked at, s. Chosen: a fraction of the time between two."""


def run_unit(station: Station, unit: int, *, address: str | None = None, dry_run: bool = False) -> None:
    """Be one unit until `station.ended`, or until its recorded video is over.

    Args:
        station: what the process has.
        unit: its number.
        address: of a camera in place of the lab's.
        dry_run: send no flight commands.
    """
    lab = station.lab
    camera, core = lab.camera(unit), lab.make_unit(unit)
    post = station.post(core.name, HEARS)
    dictionary = lab.model.markers.dictionary
    detector = create_detector(camera.detector, dictionary=dictionary, deferring=True)
    warm_up(camera.detector, dictionary)
    with ExitStack() as stack:
        diary = stack.enter_context(station.diary(core.name))
        told = Told(station, diary)
        reader = _open(station, told, camera.address if address is None else address)
        if reader is None:
            return
        stack.enter_context(reader)
        pictures = lab.model.recording
        album = stack.enter_context(Album(unit, pictures.image_rate_hz, pictures.image_width_px))
        fly = _autopilot(station, post, stack, unit, dry_run=dry_run)
        at_work = UnitAtWork(station, core, post, reader, detector, fly, diary, album, told)
        while not (station.ended() or reader.ended):
            frame = reader.newest(NEWEST_S)
            at_work.listen()
            trouble = reader.trouble
            if frame is not None:
                trouble = at_work.look(frame, trouble)
            at_work.report(trouble)
            if frame is not None:
                at_work.look_around(frame)
        diary.put("/end", station.clock(), {})


@dataclass
class UnitAtWork:
    """The steps of a unit's rounds: it listens, looks at its newest image, reports, and looks around.

    Attributes:
        station: what the process has.
        core: decides.
        post: its messages.
        reader: of its camera.
        detector: of markers.
        fly: takes its flight commands.
        diary: its recording.
        album: makes the recording's pictures.
        told: says lines to people.
    """

    station: Station
    core: UnitCore
    post: Post
    reader: CameraReader
    detector: Detector
    fly: Callable[[FlightCommand], object]
    diary: Diary
    album: Album
    told: Told
    _beats: Beats = field(default_factory=Beats, init=False)
    _state: str = field(default="no image yet", init=False)

    def __post_init__(self) -> None:
        self._mirrored = MirrorWatch(self.station.lab.model.markers.dictionary, self.station.clock)

    def listen(self) -> None:
        """Take in what has come over the radio."""
        for arrival in self.post.fetch():
            self.diary.heard(arrival)
            self.core.receive(arrival.envelope, arrival.received_s)

    def look(self, frame: Frame, trouble: str | None) -> str | None:
        """Find the markers in an image, and decide on them unless something is wrong with it.

        Args:
            frame: the image.
            trouble: what is wrong with it by its reader.

        Returns:
            What is wrong with it, if anything is.
        """
        clock = self.station.clock
        begun_s = clock()
        detections = self.detector.detect(frame.image, time_s=frame.captured_s, unit_id=self.core.unit_id)
        found_s = clock()
        trouble = trouble or self._mirrored.look(frame, detections)
        news, view = (None, None) if trouble else self._decide(frame, detections, begun_s, found_s)
        self.album.show(frame.image, detections, None if news is None else news.decision, view)
        self._state = _described(detections, view)
        return trouble

    def look_around(self, frame: Frame) -> None:
        """Search the image for what can wait until the decision on it was sent."""
        if isinstance(self.detector, DeferringDetector):
            self.detector.look_around(frame.image, unit_id=self.core.unit_id)

    def _decide(
        self, frame: Frame, detections: Detections, begun_s: float, found_s: float
    ) -> tuple[UnitNews | None, View | None]:
        """Decide on detections, send what is decided, and then keep all of it, so that nobody waits."""
        news = self.core.see(detections, found_s)
        for message in () if news is None else news.messages:
            self.post.send(message)
        sent_s = self.station.clock()
        view = None
        if news is not None:
            self.fly(news.decision.flight)
            view = view_of(news.decision, self.station.lab.template)
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
        keep_image(self.diary, detections, news, view, stages)
        return news, view

    def report(self, trouble: str | None) -> None:
        """Tell people what is wrong, keep pictures that are done, and give a sign of life when it is time."""
        problem = "; ".join(filter(None, (trouble or self.core.trouble, self.diary.trouble)))
        self.told.say(f"{self.core.name}: {problem}" if problem else "")
        now_s = self.station.clock()
        for topic, record in self.album.done():
            self.diary.keep(topic, now_s, record)
        if self._beats.due(now_s):
            self.post.send(self.core.beat(now_s, problem or self._state))
            counts = {"refused": self.post.refusals.counts, "dropped": self.post.dropped}
            self.diary.put("/beat", now_s, counts)


def keep_image(
    diary: Diary, detections: Detections, news: UnitNews | None, view: View | None, stages: dict[str, Any]
) -> None:
    """Keep what came of an image, after it was sent, so that nobody waits for it."""
    diary.saw(detections, stages["found_s"])
    diary.put("/sent", stages["sent_s"], {"messages": None if news is None else news.messages})
    if view is not None:
        diary.keep("/view", stages["sent_s"], view)
    diary.put("/stages", stages["sent_s"], stages)


def _described(detections: Detections, view: View | None) -> str:
    """What a unit says of its newest image."""
    error = np.nan if view is None else view.shape_error
    known = f", shape error {100 * error:.2g} %" if np.isfinite(error) else ""
    return f"{len(detections)} markers{known}"


def _open(station: Station, told: Told, address: str) -> CameraReader | None:
    """The camera, which may take a while to be there; None if the process is to end before."""
    while not station.ended():
        try:
            return open_camera(address, clock=station.clock)
        except InputError as error:
            if "://" not in address:
                raise
            told.say(f"waits for its camera: {error}")
            time.sleep(0.5)
    return None


def _autopilot(
    station: Station, post: Post, stack: ExitStack, unit: int, *, dry_run: bool
) -> Callable[[FlightCommand], object]:
    """Where the flight commands of a unit go."""
    address = station.lab.camera(unit).driver
    if address is None or dry_run:
        return lambda command: None
    if address == WORLD:
        return post.send
    limits = station.lab.speed_limits
    driver = stack.enter_context(open_driver(address, robot_id=unit, limits=limits, flies=True))
    return driver.send_flight
