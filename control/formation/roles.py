"""Interchangeable roles: the units decide which robot takes which point of the template.

Roles are one map. It is a permutation with a version, and every report contains the whole map. A unit follows
the newest map that it has received. Therefore

- no unit ever assigns one point to two robots, since every map is a permutation;
- message loss only costs time, and a failed unit takes no information with it;
- no acknowledgement is needed. If two units had to agree on each exchange, message loss could leave them in
  disagreement. A robot could then only pass from neighbour to neighbour.

Only one unit at a time may create a newer map. It is the unit with the current slot of the team's time among
the units with received reports. All of these must have reported the map from which it starts. It creates the
map for the whole team, whose positions it knows from `skyherd.control.formation.registration`.

Until a newer map has reached all units, two units may assign one point to two robots. This lasts for the
delay of one message. With a message loss rate p it lasts longer than n messages with probability p^n.

An exchange must lower the residual J (`skyherd.control.formation.assignment`) by a share of it. The robots'
own motion lowers J as well, so that exchanges come to an end. docs/bodies.md has the details.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from skyherd.control.formation.assignment import best_assignment, correlation
from skyherd.control.formation.registration import Registration
from skyherd.control.formation.template import Template
from skyherd.control.topology.slots import slot_at
from skyherd.geometry import ComplexArray, IntArray
from skyherd.messages import NO_ID, RoleMap, UnitReport
from skyherd.messages.checks import check_kind, check_numbers


@dataclass(frozen=True)
class RoleRule:
    """Settings of the role exchange.

    Attributes:
        period_s: length of the slot in which one unit may exchange roles.
        gain: share of the residual J by which an exchange must lower it.
        starts: number of start rotations of the search, if more robots are known than at the last search.
        classes: (N,) class of each robot of the team; roles are exchanged within a class only. None if all
            robots are alike.
    """

    period_s: float = 1.0
    gain: float = 0.05
    starts: int = 24
    classes: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        check_numbers(self, positive=("period_s", "starts"), not_negative=("gain",))


@dataclass
class Roles:
    """Map from robots to template points, as one unit knows it.

    Attributes:
        rule: settings; None for fixed roles.
        template: the shape, with each robot's own point.
        map: the newest map received or created.
        shape: the template with the robots' points exchanged by the map.
    """

    rule: RoleRule | None
    template: Template
    map: RoleMap = field(init=False)
    shape: Template = field(init=False)
    _slot: int = field(default=-1, init=False)
    _known_robots: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._use(RoleMap(0, NO_ID, np.arange(self.template.ids.size)))

    @property
    def reported(self) -> RoleMap | None:
        """Map for the unit's report; None for fixed roles."""
        return self.map if self.rule else None

    def use_template(self, template: Template) -> None:
        """Change to another shape; the map stays until the next exchange, which searches all rotations."""
        if template is not self.template:
            self.template, self._known_robots = template, 0
            self._use(self.map)

    def receive(self, reports: Sequence[UnitReport]) -> None:
        """Change to the newest map in the reports if it is newer than the unit's own."""
        if self.rule is None:
            return
        robots = self.map.roles.size
        received = [
            report.roles
            for report in reports
            if report.roles is not None and report.roles.roles.size == robots
        ]
        newest = max(received, key=lambda role_map: role_map.precedence, default=self.map)
        if newest.precedence > self.map.precedence:
            self._use(newest)

    def may_exchange(self, unit_id: int, time_s: float, reports: Sequence[UnitReport]) -> bool:
        """Return whether the unit may create a newer map now.

        This is allowed at its first image in its own slot, if all units that report roles follow the same
        map. Slot number `floor(time / period)` belongs to the units with known reports in turn, in the order
        of their ids. The call has a side effect: it stores the slot. It must be made once per image.
        """
        if self.rule is None:
            return False
        slot, before = slot_at(time_s, self.rule.period_s), self._slot
        self._slot = slot
        units = sorted({unit_id, *(report.unit_id for report in reports)})
        if slot == before or units[slot % len(units)] != unit_id:
            return False
        own = self.map.precedence
        return all(report.roles is None or report.roles.precedence == own for report in reports)

    def exchange(self, unit_id: int, team: Registration) -> bool:
        """Create a newer map if one lowers the residual by more than the gain; return whether it did.

        Call it only if `may_exchange` allows it. Robots with unknown positions keep their points.

        Args:
            unit_id: the unit, which becomes the map's author.
            team: positions of the team's robots in the unit's image.
        """
        if self.rule is None:
            return False
        rows = np.flatnonzero(team.known)
        if rows.size < 2:
            return False
        more_known, self._known_robots = rows.size > self._known_robots, rows.size
        roles = self.map.roles.copy()
        robots, points = team.points_px[rows], self.template.points_px[roles[rows]]
        classes = np.array(self.rule.classes or [0] * roles.size)[rows]
        order = best_assignment(robots, points, classes, starts=self.rule.starts if more_known else 0)
        if not _residual(robots, points[order]) < (1 - self.rule.gain) * _residual(robots, points):
            return False
        roles[rows] = roles[rows][order]
        self._use(RoleMap(self.map.version + 1, unit_id, roles))
        return True

    def _use(self, role_map: RoleMap) -> None:
        self.map = role_map
        self.shape = Template(self.template.ids, self.template.points_px[role_map.roles])


def _residual(robots: ComplexArray, points: ComplexArray) -> float:
    """Return the residual J, px², of robots (M,) and points (M,) under the best similarity."""
    x, p = robots - robots.mean(), points - points.mean()
    return float(np.vdot(x, x).real - abs(correlation(robots, points)) ** 2 / np.vdot(p, p).real)


def newest_roles(maps: Sequence[RoleMap | None], robots: int) -> IntArray:
    """Return template rows (N,) of the robots by the newest of several maps; the identity if all are None."""
    known = [role_map for role_map in maps if role_map is not None]
    for role_map in known:
        check_kind("newest_roles: maps", role_map, RoleMap, "RoleMaps, or None")
    return max(known, key=lambda role_map: role_map.precedence).roles if known else np.arange(robots)
