"""Check of the cameras of a lab, for their set-up: coverage, overlap, marker sizes, light and blur."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import combinations

import numpy as np

from skyherd.analysis.views import MIN_MARKER_PX
from skyherd.assembly import make_size
from skyherd.control import Rectifier, rectified
from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.live.cameras import Frame, open_camera
from skyherd.live.lab.set_up import Lab
from skyherd.markers.dictionary import cells_per_side
from skyherd.messages import Detections, among
from skyherd.poses import Calibration
from skyherd.vision import MAX_BLUR_CELLS, MIN_MARKER_CONTRAST, create_detector, measure_marker_images

GOOD_MARKER_PX = 20.0
"""Side of a marker, px, from which on it has a reserve for noise and blur. Chosen: 1.7 of `MIN_MARKER_PX`."""

GOOD_BLUR_CELLS, GOOD_CONTRAST = 0.5, 60.0
"""Blur, cells, and contrast, grey levels, with a reserve. Chosen: two thirds and five times of the limits."""

MAX_STREAK_CELLS, MOTION_BLUR_CELLS = 1.5, 0.1
"""Streak of motion, cells, up to which markers are detected, and the blur that a streak of two thirds adds to
that at rest. Measured on markers with cells of 8 and 12 px that move along one axis."""

SATURATED = 252.0
"""Grey level of white from which on it is overexposed. Chosen: 255 less noise."""

MIN_SEEN = 0.9
"""Share of the images in which a robot should be seen. Chosen: single misses are common at the border."""

MIN_MARGIN_SIDES = 1.5
"""Distance of a marker's centre from the border of the image, marker sides. Chosen: beyond the card."""

IMAGES_PER_TIMEOUT = 2.5
"""Images within `limits.goal_timeout_s`. Chosen: one may be lost or late."""

MOVING_SIDES = 0.02
"""Motion between two images, in marker sides, from which on a marker moves. Chosen: far above its noise."""

FIRST_IMAGE_S = 5.0
"""Longest wait for the first image, s. Chosen: a key frame may take some seconds."""

MIN_SHARED = 2
"""Robots that two neighbouring cameras should share. Chosen: one gives no direction between their images."""

CIRCLE = np.exp(2j * np.pi * np.arange(36) / 36)
"""Points of a circle."""


class Level(StrEnum):
    """Weight of a finding."""

    GOOD = "ok"
    ADVICE = "advice"
    PROBLEM = "problem"


@dataclass(frozen=True)
class Finding:
    """One result of the check.

    Attributes:
        level: its weight.
        text: what was found, and what to change.
    """

    level: Level
    text: str


COLUMNS = ("id", "u_px", "v_px", "side_px", "black", "white", "blur_cells", "moves")
"""Columns of the table of markers of a survey."""


@dataclass
class CameraSurvey:
    """Robots in some images of one camera.

    Attributes:
        lab: the lab.
        images: number of images.
        size_px: width and height of the images.
        times_s: times of capture of the first and the last image.
        stamped_by: source of the times.
        seen: number of images of each robot that was seen.
        trouble: fault of the last image by its reader, or None.
        calibration: intrinsics that the lab names for it, or None.
    """

    lab: Lab
    images: int = 0
    size_px: tuple[int, int] = (0, 0)
    times_s: tuple[float, float] = (0.0, 0.0)
    stamped_by: str = ""
    seen: Counter[int] = field(default_factory=Counter)
    trouble: str | None = None
    calibration: Calibration | None = None
    _rows: list[Array] = field(default_factory=list)
    _last: Detections | None = None
    _rectifier: Rectifier = field(default_factory=Rectifier)

    def add(self, frame: Frame, found: Detections) -> None:
        """Add an image and the markers in it."""
        lab, height, width = self.lab, *frame.image.shape
        self.times_s = (self.times_s[0] if self.images else frame.captured_s), frame.captured_s
        self.images, self.size_px, self.stamped_by = self.images + 1, (width, height), frame.stamped_by
        robots = lab.robots_of(found, frame.image)
        robots = robots[among(robots.ids, lab.ids)]
        self.seen.update(robots.ids.tolist())
        if lab.model.control.rectify:
            self._rectifier.rectify(robots.unambiguous())
        own = lab.ids if lab.layout is None else lab.layout.ids.tolist()
        markers = found[among(found.ids, own)]
        images = measure_marker_images(frame.image, markers, lab.model.markers.dictionary)
        self._rows.append(
            np.column_stack(
                [
                    markers.ids,
                    markers.centers_px,
                    markers.sides_px,
                    images.blacks,
                    images.whites,
                    images.blurs_cells,
                    self._moves(markers),
                ]
            )
        )
        self._last = markers

    def _moves(self, markers: Detections) -> Array:
        """Return 1 for each marker (N,) that moved since the last image, and 0 for the others."""
        moves = np.zeros(len(markers))
        if self._last is not None:
            _, here, there = np.intersect1d(markers.ids, self._last.ids, return_indices=True)
            moved = np.linalg.norm(markers.centers_px[here] - self._last.centers_px[there], axis=1)
            moves[here] = moved > MOVING_SIDES * markers.sides_px[here]
        return moves

    def column(self, name: str) -> Array:
        """Return a column (M,) of the table of all markers in all images."""
        table = np.concatenate(self._rows) if self._rows else np.zeros((0, len(COLUMNS)))
        return np.asarray(table[:, COLUMNS.index(name)])

    @property
    def rate_hz(self) -> float:
        """Rate of the images; NaN for fewer than two."""
        passed_s = self.times_s[1] - self.times_s[0]
        return (self.images - 1) / passed_s if passed_s > 0 else np.nan

    def findings(self) -> Iterator[Finding]:
        """Yield the results for this camera."""
        if self.trouble is not None:
            yield Finding(Level.ADVICE, self.trouble)
        yield from self._calibrated_size()
        yield from self._coverage()
        if not self.column("id").size:
            return
        yield from self._sizes()
        yield from self._light()
        yield from self._blur()
        yield from self._time()
        if len(self.lab.model.cameras) == 1:
            yield from self._room()

    @property
    def is_fine(self) -> bool:
        """True if no finding is a problem."""
        return all(finding.level is not Level.PROBLEM for finding in self.findings())

    def _calibrated_size(self) -> Iterator[Finding]:
        if self.calibration is not None:
            try:
                self.calibration.check_image("calibration", self.size_px)
            except InputError as error:
                yield Finding(Level.PROBLEM, str(error))

    def _coverage(self) -> Iterator[Finding]:
        if not self.seen:
            advice = "no robot seen: check aim, focus and light; `skyherd detect --explain` explains an image"
            yield Finding(Level.PROBLEM, advice)
            return
        rare = [robot for robot, count in sorted(self.seen.items()) if count < MIN_SEEN * self.images]
        yield Finding(Level.GOOD, f"robots {_named(self.seen)} of {len(self.lab.ids)} seen")
        if rare:
            yield Finding(Level.ADVICE, f"robots {_named(rare)} seen in some images only")
        width, height = self.size_px
        places = np.column_stack([self.column("u_px"), self.column("v_px")])
        margins = np.minimum(places, np.array([width - 1, height - 1]) - places).min(axis=1)
        close = np.unique(self.column("id")[margins < MIN_MARGIN_SIDES * self.column("side_px")])
        if close.size:
            near = f"markers {_named(close.astype(int).tolist())} are near the border of the image"
            yield Finding(Level.ADVICE, f"{near}: aim the camera at the middle of the robots, or raise it")

    def _sizes(self) -> Iterator[Finding]:
        sides_px = self.column("side_px")
        text = f"markers {sides_px.min():.0f} to {sides_px.max():.0f} px wide (limit {MIN_MARKER_PX:.0f})"
        change = ": move the camera nearer, raise its resolution, or print larger markers"
        if sides_px.min() < GOOD_MARKER_PX:
            level = Level.PROBLEM if sides_px.min() < MIN_MARKER_PX else Level.ADVICE
            yield Finding(level, text + change)
        else:
            yield Finding(Level.GOOD, text)

    def _light(self) -> Iterator[Finding]:
        black, white = self.column("black"), self.column("white")
        contrast = float(np.median(white - black))
        text = f"black {np.median(black):.0f}, white {np.median(white):.0f} of 255"
        bright = float(np.mean(white >= SATURATED))
        if contrast < GOOD_CONTRAST:
            level = Level.PROBLEM if contrast < MIN_MARKER_CONTRAST else Level.ADVICE
            yield Finding(level, f"{text}: add light, or lengthen the exposure")
        elif bright > 1 - MIN_SEEN:
            yield Finding(Level.ADVICE, f"{text}: overexposed; shorten the exposure, or remove glare")
        else:
            yield Finding(Level.GOOD, text)

    def _blur(self) -> Iterator[Finding]:
        blurs, moves = self.column("blur_cells"), self.column("moves") > 0
        rest = float(np.median(blurs[~moves])) if (~moves).any() else np.nan
        worst = float(np.quantile(blurs[moves], MIN_SEEN)) if moves.any() else np.nan
        parts = [(rest, "at rest"), (worst, "moving")]
        text = " and ".join(f"{value:.2f} cells {when}" for value, when in parts if np.isfinite(value))
        text = f"blur {text} (limit {MAX_BLUR_CELLS:g})"
        if rest > GOOD_BLUR_CELLS:
            yield Finding(Level.ADVICE, f"{text}: focus the camera, or print larger markers")
        elif worst > GOOD_BLUR_CELLS or worst - rest > MOTION_BLUR_CELLS:
            yield Finding(Level.ADVICE, f"{text}: shorten the exposure, and add light")
        else:
            yield Finding(Level.GOOD, text)
        yield self._exposure()

    def _exposure(self) -> Finding:
        """Return the longest exposure for which robots at the speed limit are detected."""
        markers, limits = self.lab.model.markers, self.lab.model.limits
        cell_m = markers.side_m / cells_per_side(markers.dictionary)
        longest_s = MAX_STREAK_CELLS * cell_m / limits.max_speed_mps
        text = f"at max_speed_mps an exposure of up to {1000 * longest_s:.0f} ms keeps markers legible"
        if self.rate_hz * longest_s < 1:
            return Finding(Level.ADVICE, f"{text}, less than between two images: set a shorter one by hand")
        return Finding(Level.GOOD, text)

    def _time(self) -> Iterator[Finding]:
        timeout_s = self.lab.model.limits.goal_timeout_s
        text = f"{self.rate_hz:.1f} images/s, stamped by {self.stamped_by}"
        if not self.rate_hz * timeout_s >= IMAGES_PER_TIMEOUT:
            change = f": too few for goal_timeout_s = {timeout_s:g}; raise the rate or the timeout"
            yield Finding(Level.ADVICE, text + change)
        else:
            yield Finding(Level.GOOD, text)

    def _room(self) -> Iterator[Finding]:
        """Compare the image with the circle around the robots in which the shape fits in any direction."""
        last, template = self._last, self.lab.template
        rule = make_size(self.lab.model.shape.size, template, self.lab.model.markers.side_m)
        if last is None or not len(last) or rule.is_free:
            return
        ground = self._rectifier.ground_map
        flat = rectified(last, ground)
        around = np.abs(template.points_px - template.points_px.mean()).max() / template.spacing_px
        radius_sides = float(around) * rule.min_sides + 1.0
        middle = flat.centers_px.mean(axis=0)
        radius_px = radius_sides * float(np.median(flat.sides_px))
        circle = middle + radius_px * np.column_stack([CIRCLE.real, CIRCLE.imag])
        places = ground.image_px(circle, last.image_size_px)
        inside = ((places >= 0) & (places <= last.image_size_px - 1)).all(axis=1)
        radius_m = radius_sides * self.lab.model.markers.side_m
        text = f"the shape needs a circle of {radius_m:.2f} m around the robots"
        if inside.all():
            yield Finding(Level.GOOD, f"{text}, all in view")
        else:
            change = "raise the camera, aim it at the robots, or make the shape smaller"
            yield Finding(Level.ADVICE, f"{text}, of which {np.mean(~inside):.0%} is out of view: {change}")


def watch_camera(lab: Lab, unit: int, seconds: float) -> CameraSurvey:
    """Return what the camera of a unit shows for some seconds.

    Raises:
        InputError: it cannot be opened, or shows no image within `FIRST_IMAGE_S`. Its calibration cannot be
            read.
    """
    survey, camera = CameraSurvey(lab, calibration=lab.calibration(unit)), lab.camera(unit)
    detector = create_detector(camera.detector, dictionary=lab.model.markers.dictionary)
    with open_camera(camera.address) as reader:
        frame, ends_s = reader.newest(FIRST_IMAGE_S), time.monotonic() + seconds
        while frame is not None:
            survey.add(frame, detector.detect(frame.image, time_s=frame.captured_s, unit_id=unit))
            survey.trouble = reader.trouble
            left_s = ends_s - time.monotonic()
            frame = reader.newest(left_s) if left_s > 0 and not reader.ended else None
        if not survey.images:
            what = reader.trouble or f"no picture within {FIRST_IMAGE_S:g} s"
            raise InputError(reader.name, what, "a camera that sends pictures")
    return survey


def team_findings(lab: Lab, seen: Sequence[AbstractSet[int]]) -> Iterator[Finding]:
    """Yield the results for all cameras together: robots that none sees, and overlap.

    Args:
        lab: the lab.
        seen: robots that each camera sees.
    """
    lost = sorted(set(lab.ids).difference(*seen))
    if lost:
        yield Finding(Level.PROBLEM, f"robots {_named(lost)} seen by no camera: move a camera, or the robots")
    if len(seen) < 2:
        return
    joined, edges = {0}, []
    for one, other in combinations(range(len(seen)), 2):
        shared = sorted(seen[one] & seen[other])
        if shared:
            yield Finding(Level.GOOD, f"cameras {one} and {other} share robots {_named(shared)}")
        if len(shared) >= MIN_SHARED:
            edges.append({one, other})
    for _ in seen:
        joined |= {unit for edge in edges if edge & joined for unit in edge}
    apart = sorted(set(range(len(seen))) - joined)
    if apart:
        who = f"camera {_named(apart)} shares" if len(apart) == 1 else f"cameras {_named(apart)} share"
        text = f"{who} fewer than {MIN_SHARED} robots with the others"
        yield Finding(Level.ADVICE, f"{text}: let their images overlap more")


def _named(ids: Iterator[int] | Sequence[int] | Counter[int]) -> str:
    return ", ".join(map(str, sorted(ids)))
