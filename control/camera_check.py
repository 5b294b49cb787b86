"""Consistency of a unit's images with the motion that it commands.

A camera may freeze, lag or replay old images while its time stamps stay fresh. The unit would then steer
robots by places that they have left. It knows its own commands, the robots' law and their top speed. An image
in which nothing moves although robots must, or in which most robots jump, contradicts them.

The check has three states:

- *Trusted*: the unit sends goals, bodies and reports. It suspects the camera if a robot that must have moved
  by `MOVED_SIDES` is within `STILL_SIDES`, with the whole image. It also does so if a neighbour's images show
  such a motion and its own do not, or if half of the robots jump further than they can drive.
- *Suspected*: the unit sends nothing and holds its position. It trusts the camera again once the image has
  changed, and its own robots have then stood still for `STEADY_S`.
- *Latched*: as suspected, until `reset`. A unit with an operator latches the `RECURRING`th suspicion within
  `RECURRING_S`. Without an operator there is no such state.

A suspected unit sends no goals, so that its own robots stop. A delayed camera shows that only after its
delay. The unit therefore trusts it only when its images are up to date again. Such a camera is suspected
again and again, since its robots stand in its images while they drive. When the check trusts a camera again,
it compares the motion in the last images with the commanded motion of earlier times (`image_delay`). If both
agree only at a delay, the next suspicion names it. docs/bodies.md lists the faults that cannot be detected.
"""

from collections import deque
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from skyherd.control.avoidance.speed_bound import AvoidanceRule
from skyherd.control.formation.similarity import fit_similarity
from skyherd.control.image_delay import MAX_DELAY_S, MEMORY_S, RESPONSIVE, SAMPLE_S, measured_delay_s
from skyherd.control.robots.unicycle import RobotLaw
from skyherd.control.team_view import TeamView
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, BoolArray, IntArray, median, to_complex
from skyherd.messages import Detections, MotionGoals, Proximity, UnitReport, among, find_rows
from skyherd.messages.checks import check_numbers

MOVED_SIDES = 0.1
"""Commanded motion after which a robot must be seen to move, marker sides. Chosen: at `MIN_PACE_SIDES_PS` it
takes 0.5 s, half of the time in which a frozen camera must be detected."""

STILL_SIDES = 0.02
"""Motion in the image up to which a robot stands still, marker sides. Chosen: a fifth of `MOVED_SIDES`, which
1.3 % of driving robots fall below (docs/bodies.md), and above the noise of a centre, 0.003 sides."""

MIN_PACE_SIDES_PS = 0.2
"""Minimum commanded pace that counts, marker sides per second. Chosen: above the dead zones of wheels, so
that a robot that stops short of its goal does not count."""

JUMP_SIDES = 1.0
"""Motion between two images, beyond the robots' top speed, above which they jump, marker sides. Chosen: above
the distortion between two images of a swaying, tilted camera."""

JUMPING = 0.5
"""Minimum share of robots that jump at a fault. Chosen: single robots may be carried or misread."""

MIN_JUMPERS = 5
"""Minimum number of robots for the detection of jumps. Chosen: with fewer, one misread marker moves the
fit."""

MAX_GAP_S = 1.0
"""Maximum time between two images that are compared, s. Chosen: robots forget their goals before."""

STEADY_S = 1.0
"""Time for which robots without goals must stand still before the camera is trusted again, s. Chosen: twice
the time in which a robot forgets its goal."""

STEADY_SIDES = 0.15
"""Relative motion up to which robots stand still while the camera is suspected, marker sides. Chosen: above
the distortion between images of a swaying camera; a robot at `MIN_PACE_SIDES_PS` exceeds it within
`STEADY_S`."""

TRIAL_S = 1.0
"""Time, beyond the lag, in which a robot is judged by its response, s. Chosen: it moves by 0.2 sides at
`MIN_PACE_SIDES_PS`."""

RECURRING, RECURRING_S = 3, 30.0
"""Number of suspicions within a time, s, of which a unit with an operator latches the last. Chosen: measured,
a camera late by 1 s is suspected every 3.3 s, and one late by 3 s every 5.4 s. A single outage of a stream
causes one suspicion."""


@dataclass(frozen=True)
class CameraRule:
    """The robots' response to goals, as units know it.

    Attributes:
        law: speed law of the robots.
        side_m: side of the markers.
        max_speed_mps: top speed of the robots.
        lag_s: maximum time from an image to the visible effect of its goals.
        avoidance: the robots' bound on approach speeds; None without avoidance.
        has_operator: whether an operator can clear a latched suspicion (`CameraCheck.reset`). Without one, no
            suspicion is latched.
    """

    law: RobotLaw
    side_m: float
    max_speed_mps: float
    lag_s: float = 0.4
    avoidance: AvoidanceRule | None = None
    has_operator: bool = False

    def __post_init__(self) -> None:
        check_numbers(self, positive=("side_m", "max_speed_mps"), not_negative=("lag_s",))

    def paces(self, goals: MotionGoals, proximity: Proximity | None) -> Array:
        """Return minimum paces (N,), marker sides per second, at which robots follow their goals.

        Near other bodies a robot may drive at the smallest of the bounds on its approach speeds.
        """
        lengths = goals.rho_px if self.law.needs_distances else goals.rho_px / goals.sides_px
        speeds_mps = np.minimum(np.abs(self.law.speed_mps(lengths)), self.max_speed_mps)
        if self.avoidance is not None:
            speeds_mps = np.minimum(speeds_mps, self._allowed_mps(goals.ids, proximity, self.avoidance))
        return np.asarray(speeds_mps / self.side_m)

    def _allowed_mps(self, ids: IntArray, proximity: Proximity | None, avoidance: AvoidanceRule) -> Array:
        """Return speeds (N,), m/s, that the bodies near robots (N,) allow in every direction."""
        allowed = np.zeros(ids.size)
        if proximity is None:
            return allowed
        allowed[:] = np.inf
        reaches_sides = proximity.reaches_sides + proximity.ways_sides
        gaps_m = (proximity.distances_sides - reaches_sides) * self.side_m
        # Twice the nominal age: some messages are lost.
        ages_s = np.full(gaps_m.size, 2 * avoidance.nominal_age_s)
        limits_mps = avoidance.limit_mps(proximity.shares * np.maximum(gaps_m, 0.0), ages_s)
        order = np.argsort(ids)
        rows, found = find_rows(ids[order], proximity.robot_ids)
        np.minimum.at(allowed, order[rows[found]], limits_mps[found])
        return allowed


class CameraCheck:
    """Monitor of one unit's images; one instance per unit.

    Attributes:
        suspicion: reason why the camera is suspected; empty while it is trusted.
        is_latched: whether the suspicion lasts until `reset`.

    Args:
        rule: the robots' response to goals.
        ids: (N,) the team, ascending.
    """

    def __init__(self, rule: CameraRule, ids: IntArray) -> None:
        self._rule, self._ids = rule, ids
        self._others: dict[int, TeamView] = {}
        self._paces: deque[tuple[float, Array]] = deque()
        self._samples: deque[TeamView] = deque()
        self._suspected_s: deque[float] = deque()
        self._idle = np.zeros(ids.size, dtype=bool)
        self.reset()

    def reset(self) -> None:
        """Trust the camera, as at the start."""
        self.suspicion, self.is_latched = "", False
        self._last: TeamView | None = None
        self._still: TeamView | None = None
        self._trial: TeamView | None = None
        self._frozen: TeamView | None = None
        self._delay_s = 0.0
        self._paces.clear()
        self._samples.clear()
        self._suspected_s.clear()

    def look(self, detections: Detections, reports: Sequence[UnitReport]) -> str:
        """Judge an image, and return the reason why the camera is suspected, or an empty string.

        Args:
            detections: markers of the image as detected, in the team's time.
            reports: recent reports of the other units.
        """
        view = self._view(detections)
        if view is None:
            return self.suspicion
        last, self._last = self._last, view
        if last is None or not 0 < view.time_s - last.time_s <= MAX_GAP_S:
            self._still, self._trial = view, view
            self._others.clear()
            self._samples.clear()
            return self.suspicion
        self._keep(view)
        if self.is_latched:
            return self.suspicion
        if self.suspicion:
            self._look_again(view, last, reports)
        elif contradiction := self._contradiction(view, last, reports):
            self._suspect(contradiction, view)
        return self.suspicion

    def _suspect(self, contradiction: str, view: TeamView) -> None:
        """Suspect the camera from this image on, and latch the suspicion if it recurs."""
        self._frozen = view
        self._suspected_s.append(view.time_s)
        while view.time_s - self._suspected_s[0] > RECURRING_S:
            self._suspected_s.popleft()
        if len(self._suspected_s) == 1:
            self._delay_s = 0.0
        self.is_latched = self._rule.has_operator and len(self._suspected_s) >= RECURRING
        recurs = f"; suspected {RECURRING} times within {RECURRING_S:g} s" if self.is_latched else ""
        self.suspicion = (self._lateness() or contradiction) + recurs

    def _lateness(self) -> str:
        """Return the delay measured after the last suspicion, as a text; empty if none was found."""
        if not self._delay_s:
            return ""
        return (
            f"images are late: they follow the commands after about {self._delay_s:.1f} s instead of "
            f"{self._rule.lag_s:.1f} s at most; the camera's encoder or the network delays them"
        )

    def command(
        self,
        goals: MotionGoals | None,
        proximity: Proximity | None,
        reports: Sequence[UnitReport],
        obeying_ids: AbstractSet[int] | None = None,
    ) -> None:
        """Record the goals sent after the last image.

        Args:
            goals: the goals; None if none were sent.
            proximity: the bodies reported to the robots.
            reports: recent reports of the other units; a robot that they control too does not count.
            obeying_ids: robots that follow goals now; all if None.
        """
        if self._last is None:
            return
        paces = np.zeros(self._ids.size)
        if goals is not None:
            rows = self._ids.searchsorted(goals.ids)
            paces[rows] = self._rule.paces(goals, proximity)
            paces[self._shared(reports)] = 0.0
            if obeying_ids is not None:
                paces[~among(self._ids, obeying_ids)] = 0.0
            paces[paces < MIN_PACE_SIDES_PS] = 0.0
        if paces.any() or not self._paces or self._paces[-1][1].any():  # a team at rest adds nothing
            self._paces.append((self._last.time_s, paces))
        starts_s = [image.time_s for image in (self._still, self._trial) if image is not None]
        starts_s.append(self._last.time_s - MEMORY_S - MAX_DELAY_S)
        while len(self._paces) > 1 and self._paces[1][0] <= min(starts_s):
            self._paces.popleft()

    def _keep(self, view: TeamView) -> None:
        """Keep an image for the measurement of a delay, unless it follows the last one too soon."""
        if self._samples and view.time_s - self._samples[-1].time_s < SAMPLE_S:
            return
        self._samples.append(view)
        while view.time_s - self._samples[0].time_s > MEMORY_S:
            self._samples.popleft()

    def _view(self, detections: Detections) -> TeamView | None:
        """Return the places of the team in an image; None without robots."""
        rows, known = find_rows(self._ids, detections.ids)
        known &= ~detections.repeated
        if not known.any():
            return None
        points_px, seen = np.zeros(self._ids.size, dtype=np.complex128), np.zeros(self._ids.size, dtype=bool)
        points_px[rows[known]] = to_complex(detections.centers_px[known])
        seen[rows[known]] = True
        return TeamView(detections.time_s, points_px, seen, median(detections.sides_px[known]))

    def _shared(self, reports: Sequence[UnitReport]) -> BoolArray:
        """Return the mask (N,) of the robots that other units control."""
        return among(self._ids, frozenset().union(*(report.controlled for report in reports)))

    def _commanded_sides(self, since_s: float | Array, until_s: float | Array) -> Array:
        """Return the minimum commanded motions (..., N), marker sides, of goals of time spans (...)."""
        times_s = np.array([time_s for time_s, _ in self._paces])
        ends_s = np.minimum(np.append(times_s[1:], np.inf), times_s + MAX_GAP_S)
        since_s, until_s = np.asarray(since_s)[..., None], np.asarray(until_s)[..., None]
        spans_s = np.maximum(np.minimum(ends_s, until_s) - np.maximum(times_s, since_s), 0.0)
        paces = np.array([paces for _, paces in self._paces]).reshape(times_s.size, self._ids.size)
        return np.asarray(spans_s @ paces)

    def _contradiction(self, view: TeamView, last: TeamView, reports: Sequence[UnitReport]) -> str:
        """Return how an image contradicts the commands or the neighbours' images, or an empty string."""
        still, trial = self._still or view, self._trial or view
        if self._jumps(view, last):
            return "robots jump in the image; the camera may repeat old images"
        if not (view.seen & still.seen).any() or (view.moved_sides(still) > STILL_SIDES).any():
            self._still = view
            self._others.clear()
            self._judge_robots(view, trial)
            return ""
        due_s = view.time_s - self._rule.lag_s
        must = self._commanded_sides(still.time_s, due_s) >= MOVED_SIDES
        if (must & ~self._idle & view.seen & still.seen).any():
            return "no robot moves in the image, but robots were sent goals; the camera may be frozen or late"
        if any(self._moves_for(report, view, still) for report in reports):
            return "no robot moves in the image, but in another unit's; the camera may be frozen"
        return ""

    def _jumps(self, view: TeamView, last: TeamView) -> bool:
        """Return whether most robots moved further between two images than they can drive."""
        both = view.seen & last.seen
        if np.count_nonzero(both) < MIN_JUMPERS:
            return False
        reach = JUMP_SIDES + self._rule.max_speed_mps / self._rule.side_m * (view.time_s - last.time_s)
        # If no robot moves by more than half of the reach, no fit shows a jump. The similarity of three
        # quarters of n robots leaves no more squares than the identity, which leaves `n reach² / 4` at most.
        # If half of them were beyond the reach, `n / 4` of these would be in the fit, and leave more.
        if (view.moved_sides(last) <= reach / 2).all():
            return False
        jumps = view.relative_sides(last, both)[both] > reach
        return bool(np.mean(jumps) >= JUMPING)

    def _judge_robots(self, view: TeamView, trial: TeamView) -> None:
        """Find the robots that do not respond to goals, in images that show motion."""
        if view.time_s - trial.time_s < TRIAL_S + self._rule.lag_s:
            return
        commanded = self._commanded_sides(trial.time_s, view.time_s - self._rule.lag_s)
        tried = (commanded >= MOVED_SIDES) & view.seen & trial.seen
        moved = view.relative_sides(trial, np.ones(tried.size, dtype=bool))
        self._idle[tried] = moved[tried] < RESPONSIVE * commanded[tried]
        self._trial = view

    def _moves_for(self, report: UnitReport, view: TeamView, still: TeamView) -> bool:
        """Return whether another unit saw robots of this image move relative to each other while it stood."""
        theirs = self._reported(report)
        first = self._others.setdefault(report.unit_id, theirs)
        if first.time_s < still.time_s:
            self._others[report.unit_id] = theirs
            return False
        common = theirs.seen & first.seen & view.seen
        if np.count_nonzero(common) <= 2:
            return False
        try:
            scale = fit_similarity(first.points_px[common], view.points_px[common]).scale
        except DegenerateSetError:
            return False
        moved = np.sort(theirs.relative_sides(first, common)) * scale / view.side_px
        return bool(moved[-2] >= MOVED_SIDES)

    def _reported(self, report: UnitReport) -> TeamView:
        """Return the places of a report, with lengths in pixels."""
        points_px, seen = np.zeros(self._ids.size, dtype=np.complex128), np.zeros(self._ids.size, dtype=bool)
        rows, known = find_rows(self._ids, report.ids)
        points_px[rows[known]], seen[rows[known]] = to_complex(report.points_px)[known], True
        return TeamView(report.time_s, points_px, seen, 1.0)

    def _look_again(self, view: TeamView, last: TeamView, reports: Sequence[UnitReport]) -> None:
        """Trust the camera again once its image has changed and its own robots have stood still since."""
        if self._frozen is not None:
            if not (view.moved_sides(self._frozen) > STILL_SIDES).any():
                return
            self._frozen, self._still = None, view
        own = ~self._shared(reports)
        moves = (view.relative_sides(self._still or view, own) > STEADY_SIDES).any()
        if moves or self._jumps(view, last):
            self._still = view
        elif self._still is not None and view.time_s - self._still.time_s >= STEADY_S:
            reach = self._rule.max_speed_mps / self._rule.side_m
            self._delay_s = measured_delay_s(self._samples, self._commanded_sides, reach, self._rule.lag_s)
            self.suspicion = ""
            self._still = self._trial = view
            # Motions of earlier suspicions would fit at a delay of one cycle more.
            self._samples.clear()
            self._paces.clear()
