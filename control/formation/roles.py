"""Interchangeable roles: units decide which robot takes which point, one exchange at a time.

The map from robots to points is one value with a version, and every report carries it whole. A unit follows
the newest map that it has heard of; so no unit ever gives one point to two robots, a lost message costs
time and nothing else, and a unit that dies takes nothing with it. Only the unit whose slot of the common
clock it is, among those that it hears, may make a newer map, and only if all of them have named the map that
it starts from. Until a newer map is heard two units may give one point to two robots: for one message's
delay, and with a share p of messages lost for longer than n messages with probability p^n. An exchange must
leave less to do by a share of what there is; what is left falls by the robots' own motion as well, so that
exchanges come to an end.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.assignment import best_assignment, correlation
from skyherd.control.formation.registration import Registration
from skyherd.control.formation.template import Template
from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages import NO_ID, RoleMap, UnitReport


@dataclass(frozen=True)
class RoleRule:
    """Settings.

    Attributes:
        period_s: length of a slot in which one unit may exchange roles.
        gain: an exchange must lower V by this share.
        starts: rotations that are tried when more of the team is known than before.
        classes: (N,) robots exchange roles within their class only; None for all alike.
    """

    period_s: float = 1.0
    gain: float = 0.05
    starts: int = 24
    classes: tuple[int, ...] | None = None


@dataclass
class Roles:
    """The map as one unit has it.

    Attributes:
        rule: settings; None where every robot keeps the role that it was given.
        template: the shape, with each robot's point as it was given.
        map: the newest map heard of.
        shape: the template under that map.
    """

    rule: RoleRule | None
    template: Template
    map: RoleMap = field(init=False)
    shape: Template = field(init=False)
    _slot: int = field(default=-1, init=False)
    _known: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._take(RoleMap(0, NO_ID, np.arange(self.template.ids.size)))

    @property
    def word(self) -> RoleMap | None:
        """What the unit's report says of roles."""
        return self.map if self.rule else None

    def take_up(self, template: Template) -> None:
        """Another shape: the map stays for now, and any rotation may be best."""
        if template is not self.template:
            self.template, self._known = template, 0
            self._take(self.map)

    def hear(self, reports: Sequence[UnitReport]) -> None:
        """Follow the newest map that anybody follows."""
        if self.rule is None:
            return
        heard = [report.roles for report in reports if report.roles is not None]
        newest = max(heard, key=lambda word: word.name, default=self.map)
        if newest.name > self.map.name:
            self._take(newest)

    def may_exchange(self, unit_id: int, time_s: float, reports: Sequence[UnitReport]) -> bool:
        """Whether this is the first image of the unit's own slot, and the others follow the same map."""
        if self.rule is None:
            return False
        slot, before = int(np.floor(time_s / self.rule.period_s + 1e-9)), self._slot
        self._slot = slot
        units = sorted({unit_id, *(report.unit_id for report in reports)})
        if slot == before or units[slot % len(units)] != unit_id:
            return False
        return all(report.roles is None or report.roles.name == self.map.name for report in reports)

    def exchange(self, unit_id: int, team: Registration) -> bool:
        """Make a newer map if there is a better one, which the unit must be free to do; whether it did."""
        if self.rule is None:
            return False
        rows = np.flatnonzero(team.known)
        if rows.size < 2:
            return False
        is_news, self._known = rows.size > self._known, rows.size
        roles = self.map.roles.copy()
        robots, points = team.points_px[rows], self.template.points_px[roles[rows]]
        classes = np.array(self.rule.classes or [0] * roles.size)[rows]
        order = best_assignment(robots, points, classes, starts=self.rule.starts if is_news else 0)
        if not _left(robots, points[order]) < (1 - self.rule.gain) * _left(robots, points):
            return False
        roles[rows] = roles[rows][order]
        self._take(RoleMap(self.map.version + 1, unit_id, roles))
        return True

    def _take(self, newer: RoleMap) -> None:
        self.map = newer
        self.shape = Template(self.template.ids, self.template.points_px[newer.roles])


def _left(robots: ComplexArray, points: ComplexArray) -> float:
    """J: the least sum of squared distances that a similarity leaves, px²."""
    x, p = robots - robots.mean(), points - points.mean()
    return float(np.vdot(x, x).real - abs(correlation(robots, points)) ** 2 / np.vdot(p, p).real)


def newest_roles(maps: Sequence[RoleMap | None], robots: int) -> IntArray:
    """Roles (N,) by the newest of several maps; each robot's own where there is none."""
    known = [word for word in maps if word is not None]
    return max(known, key=lambda word: word.name).roles if known else np.arange(robots)
