"""The two kinds of processes: a unit behind its camera, and a robot behind its driver."""

import re
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.live.album import Album
from skyherd.live.cameras import CameraReader, MirrorWatch, open_camera
from skyherd.live.diary import Diary
from skyherd.live.drivers import Motion, RobotDriver, open_driver
from skyherd.live.lab import Lab
from skyherd.live.live_clock import LiveClock
from skyherd.live.radio import Arrival, Post, Radio
from skyherd.live.robot_core import Order
from skyherd.live.unit_core import UnitNews
from skyherd.live.view import View, view_of
from skyherd.live.wire import Wheels
from skyherd.messages import Detections, FlightCommand, MotionGoals, VelocityCommand
from skyherd.vision import create_detector

BEAT_S = 0.25
"""Time between two signs of life, s. Chosen: clocks are compared four times a second."""

LEAST_SHARE = 0.2
"""Share of a period that a robot lets pass between two decisions at least. Chosen: goals of several units
come one after the other, and each is decided on at once or a few hundredths of a second later; a tenth would
have a robot under many cameras do little else."""

WORLD = "world"
"""Driver address of wheels and autopilots that `skyherd world` simulates."""

ROBOT_HEARS = ("goals/**", "proximity/**", "sighting/**", "beat/unit/*", "arm/**", "stop/**")
UNIT_HEARS = ("report/**", "beat/**", "stop/**")
"""Topics that robots and units listen to, after the team's name."""


@dataclass
class Station:
    """What every live process has.

    Attributes:
        lab: the set-up.
        radio: carries its messages.
        clock: its own.
        folder: where it records.
        tell: says a line to people.
        ended: asked before each round; True ends the process.
    """

    lab: Lab
    radio: Radio
    clock: LiveClock
    folder: Path
    tell: Callable[[str], None]
    ended: Callable[[], bool] = lambda: False

    def post(self, name: str, kinds: tuple[str, ...]) -> Post:
        """The post of a process of this name."""
        return Post(self.radio, self.lab.model.team, name, self.clock, kinds, self.tell)

    def diary(self, name: str) -> Diary:
        """A new file for a process of this name; earlier ones of the same run stay."""
        self.folder.mkdir(parents=True, exist_ok=True)
        stem = name.replace("/", "_")
        path = next(
            path
            for number in range(10_000)
            if not (path := self.folder / f"{stem}{f'.{number}' if number else ''}.mcap").exists()
        )
        return Diary(path, name, self.lab, self.clock())


_NUMBERS = re.compile(r"[\d.]+")


class Pace:
    """When a robot decides: once a period, and as soon as there are news, but not much more often.

    Attributes:
        due_s: when it decides the next time.

    Args:
        period_s: longest time between two decisions.
        now_s: now, by any clock that runs steadily.
    """

    def __init__(self, period_s: float, now_s: float) -> None:
        self.due_s = self._decided_s = now_s
        self._period_s = period_s

    def hear(self, arrival: Arrival, robot_id: int, now_s: float) -> None:
        """A message arrived: a goal for this robot is worth a decision of its own."""
        message = arrival.envelope.message
        if isinstance(message, MotionGoals) and robot_id in message.ids:
            soonest_s = self._decided_s + LEAST_SHARE * self._period_s
            self.due_s = min(self.due_s, max(now_s, soonest_s))

    def decided(self, now_s: float) -> None:
        """The robot has decided."""
        self._decided_s = now_s
        self.due_s = max(self.due_s + self._period_s, now_s)


class Told:
    """Tells people a line when it changes, and keeps it."""

    def __init__(self, station: Station, diary: Diary) -> None:
        self._station, self._diary, self._last = station, diary, ""

    def say(self, line: str) -> None:
        """Say a line unless the last one was the same but for its numbers; nothing for an empty one."""
        if (gist := _NUMBERS.sub("", line)) != self._last:
            self._last = gist
            if line:
                self._diary.put("/tell", self._station.clock(), {"line": line})
                self._station.tell(line)


class WorldWheels:
    """A link to the wheels of a simulated robot."""

    def __init__(self, post: Post, robot_id: int) -> None:
        self.name, self._post, self._robot_id = "world", post, robot_id

    def write(self, motion: Motion) -> None:
        """Send it to the world."""
        self._post.send(Wheels(self._robot_id, motion.forward_mps, motion.turn_radps))

    def close(self) -> None:
        """Nothing is open."""


def run_robot(station: Station, robot_id: int, *, dry_run: bool = False) -> None:
    """Be one robot until `station.ended`; wheels are told to stand still on the way out, whatever happens.

    Args:
        station: what the process has.
        robot_id: the robot's marker.
        dry_run: print commands in place of sending them.
    """
    lab, clock = station.lab, station.clock
    core = lab.make_robot(robot_id)
    post = station.post(core.name, ROBOT_HEARS)
    with ExitStack() as stack:
        diary = stack.enter_context(station.diary(core.name))
        driver = stack.enter_context(_driver(station, post, robot_id, dry_run=dry_run))
        told = Told(station, diary)
        beat_s = -BEAT_S
        pace = Pace(lab.model.limits.period_s, time.monotonic())
        while not station.ended():
            while (left_s := pace.due_s - time.monotonic()) > 0:
                for arrival in post.fetch(left_s):
                    diary.heard(arrival)
                    core.receive(arrival.envelope, arrival.received_s)
                    pace.hear(arrival, robot_id, time.monotonic())
            pace.decided(time.monotonic())
            now_s = clock()
            order = core.decide(now_s)
            driver.send(
                VelocityCommand(np.array([robot_id]), np.array([order.v_mps]), np.array([order.omega_radps]))
            )
            news = {"order": order, "armed": core.armed, "image_age_s": core.image_age_s(now_s)}
            diary.put("/decide", now_s, news)
            told.say(_line(core.name, order, driver.trouble or diary.trouble))
            if now_s - beat_s >= BEAT_S or now_s < beat_s:
                beat_s = now_s
                post.send(core.beat(now_s, order.reason))
                diary.put("/beat", now_s, {"refused": post.refusals.counts, "dropped": post.dropped})
        diary.put("/end", clock(), {})


def _line(name: str, order: Order, trouble: str | None) -> str:
    """What a robot says to people when it changes."""
    return f"{name}: {order.reason}{f'; {trouble}' if trouble else ''}"


def _driver(station: Station, post: Post, robot_id: int, *, dry_run: bool) -> RobotDriver:
    lab = station.lab
    address = "dry-run" if dry_run else lab.robot(robot_id).driver
    if address == WORLD:
        return RobotDriver(WorldWheels(post, robot_id), robot_id=robot_id, limits=lab.speed_limits)
    return open_driver(address, robot_id=robot_id, limits=lab.speed_limits)


def run_unit(station: Station, unit: int, *, address: str | None = None, dry_run: bool = False) -> None:
    """Be one unit until `station.ended`, or until its recorded video is over.

    Args:
        station: what the process has.
        unit: its number.
        address: of a camera in place of the lab's.
        dry_run: send no flight commands.
    """
    lab, clock = station.lab, station.clock
    camera = lab.camera(unit)
    core = lab.make_unit(unit)
    post = station.post(core.name, UNIT_HEARS)
    detector = create_detector(camera.detector, dictionary=lab.model.markers.dictionary)
    with ExitStack() as stack:
        diary = stack.enter_context(station.diary(core.name))
        told = Told(station, diary)
        reader = _open(station, told, address or camera.address)
        if reader is None:
            return
        stack.enter_context(reader)
        pictures = lab.model.recording
        album = stack.enter_context(Album(unit, pictures.image_rate_hz, pictures.image_width_px))
        mirrored = MirrorWatch(lab.model.markers.dictionary, clock)
        fly = _autopilot(station, post, stack, unit, dry_run=dry_run)
        beat_s, state = -BEAT_S, "no image yet"
        while not (station.ended() or reader.ended):
            frame = reader.newest(0.02)
            for arrival in post.fetch():
                diary.heard(arrival)
                core.receive(arrival.envelope, arrival.received_s)
            trouble = reader.trouble
            if frame is not None:
                begun_s = clock()
                detections = detector.detect(frame.image, time_s=frame.captured_s, unit_id=unit)
                found_s = clock()
                trouble = trouble or mirrored.look(frame, detections)
                news, view = None, None
                if trouble is None:
                    news = core.see(detections, found_s)
                    for message in () if news is None else news.messages:
                        post.send(message)
                    sent_s = clock()
                    if news is not None:
                        fly(news.decision.flight)
                        view = view_of(news.decision, lab.template)
                    stages = {
                        "captured_s": frame.captured_s,
                        "arrived_s": frame.arrived_s,
                        "begun_s": begun_s,
                        "found_s": found_s,
                        "sent_s": sent_s,
                        "stamped_by": frame.stamped_by,
                        "number": frame.number,
                        "dropped": reader.dropped,
                    }
                    keep_image(diary, detections, news, view, stages)
                album.show(frame.image, detections, None if news is None else news.decision, view)
                state = _state(detections, view)
            problem = "; ".join(filter(None, (trouble or core.trouble, diary.trouble)))
            told.say(f"{core.name}: {problem}" if problem else "")
            now_s = clock()
            for topic, record in album.done():
                diary.keep(topic, now_s, record)
            if now_s - beat_s >= BEAT_S or now_s < beat_s:
                beat_s = now_s
                post.send(core.beat(now_s, problem or state))
                diary.put("/beat", now_s, {"refused": post.refusals.counts, "dropped": post.dropped})
        diary.put("/end", clock(), {})


def _state(detections: Detections, view: View | None) -> str:
    """What a unit says of its newest image."""
    error = np.nan if view is None else view.shape_error
    known = f", shape error {100 * error:.2g} %" if np.isfinite(error) else ""
    return f"{len(detections)} markers{known}"


def keep_image(
    diary: Diary, detections: Detections, news: UnitNews | None, view: View | None, stages: dict[str, Any]
) -> None:
    """Keep what came of an image, after it was sent, so that nobody waits for it."""
    diary.saw(detections, stages["found_s"])
    diary.put("/sent", stages["sent_s"], {"messages": None if news is None else news.messages})
    if view is not None:
        diary.keep("/view", stages["sent_s"], view)
    diary.put("/stages", stages["sent_s"], stages)


def _open(station: Station, told: Told, address: str) -> CameraReader | None:
    """The camera, which may take a while to be there; None if the process is to end before."""
    from skyherd.errors import InputError

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
    driver = stack.enter_context(open_driver(address, robot_id=unit, limits=station.lab.speed_limits))
    return driver.send_flight
