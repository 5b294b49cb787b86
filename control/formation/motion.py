"""Motion of the shape: translation, rotation and growth, in the template's frame and without metres.

The motion of a similarity moves each point p of the shape with the velocity

    ṗ = a (w R + (g + i ω) (p' - c')),

where p' is its template point, and c' and R are the mean and the RMS radius of all template points. The
factor of the similarity in a unit's image is a = s e^{iφ}. The rates of `ShapeMotion` are w, ω and g. This
field does not change the shape. Added to the law, it leaves the error's dynamics as they are, while the shape
moves.

A robot drives at k times its goal vector. A unit therefore adds the velocity over k, the *lead*, to the goal.
Robots that several units control add up their goals, so that each unit adds its part. Neither size nor scale
of the shape is known or needed: a speed is in radii of the shape.

A unit flies along as the point of the shape at its image centre does (`drift_mps`). Its autopilot takes
metres per second, which follow from the side of the markers, as for the robots.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skyherd.control.formation.similarity import fit_goals, fit_similarity
from skyherd.control.formation.template import Template
from skyherd.errors import DegenerateSetError
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex, to_points
from skyherd.messages import Detections, UnitReport, among, rows_of
from skyherd.messages.checks import check_numbers


@dataclass(frozen=True)
class ShapeMotion:
    """Rates at which a shape moves, in the frame of the template image, which moves with the shape.

    Attributes:
        right_ps: velocity to the right of the template, RMS radii of the shape per second.
        down_ps: velocity downwards in the template, RMS radii per second.
        turn_radps: rotation about the mean of its points, clockwise seen from above.
        growth_ps: relative growth, 1/s.
    """

    right_ps: float = 0.0
    down_ps: float = 0.0
    turn_radps: float = 0.0
    growth_ps: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self, finite=("right_ps", "down_ps", "turn_radps", "growth_ps"))

    @property
    def is_rest(self) -> bool:
        """True if the shape does not move."""
        return not (self.right_ps or self.down_ps or self.turn_radps or self.growth_ps)

    def velocities(self, template: Template, points_px: ComplexArray) -> ComplexArray:
        """Return the velocities (N,) of points (N,) of a template that moves, template pixels per second."""
        arms = points_px - template.points_px.mean()
        translation = (self.right_ps + 1j * self.down_ps) * template.radius_px
        return np.asarray(translation + (self.growth_ps + 1j * self.turn_radps) * arms)


REST = ShapeMotion()
"""No motion."""


@dataclass(frozen=True)
class LeadRule:
    """Response of the robots to goals, by which units lead them along with a moving shape.

    Attributes:
        side_m: side of a marker.
        gain_ps: speed of a robot over the length of its goal vector, 1/s: k of the law.
        turn_lag_s: time by which a robot's heading is behind a goal that turns: 1 / k_ω, or 0 for robots that
            move in any direction.
        age_s: typical age of the image of a goal, if robots subtract their own motion since then; else 0.
    """

    side_m: float
    gain_ps: float
    turn_lag_s: float = 0.0
    age_s: float = 0.0

    def __post_init__(self) -> None:
        check_numbers(self, positive=("side_m", "gain_ps"), not_negative=("turn_lag_s", "age_s"))

    def lead_s(self, turn_radps: float, shares: Array) -> ComplexArray:
        """Return the factors (N,) between velocities and leads, s; angles anticipate the shape's rotation.

        A robot subtracts its motion since the image from the goal of each unit. It is therefore added to each
        goal, and the rest in shares.

        Args:
            turn_radps: rotation of the shape, clockwise seen from above.
            shares: (N,) one over the number of units that send goals to each robot.
        """
        pursued = np.exp(1j * turn_radps * (self.turn_lag_s + self.age_s)) / self.gain_ps
        return np.asarray(shares * pursued + self.age_s * np.exp(0.5j * turn_radps * self.age_s))


def leads_px(
    motion: ShapeMotion,
    rule: LeadRule,
    *,
    template: Template,
    seen: Detections,
    ids: IntArray,
    reports: Sequence[UnitReport],
    scales: tuple[float, float] = (0.0, np.inf),
) -> ComplexArray:
    """Return the leads (N,) of one unit's goals in its image, px.

    Growth beyond a bound of the size is left out. Of a robot that M units control and see, each sends 1 / M
    of the lead, since the robot adds up their goals.

    Args:
        motion: rates of the shape.
        rule: response of the robots.
        template: the whole shape.
        seen: all robots of the team in the image.
        ids: (N,) robots with goals, all of them in `seen`; at least two, at different places.
        reports: reports of the other units.
        scales: bounds of the similarity's scale, as for `motion_goals`.
    """
    current = to_complex(seen.centers_px[rows_of(seen.ids, ids)])
    fit = fit_goals(template.points_of(ids), current)
    low, high = scales
    if (fit.scale <= low and motion.growth_ps < 0) or (fit.scale >= high and motion.growth_ps > 0):
        motion = replace(motion, growth_ps=0.0)
    senders = np.ones(ids.size)
    for report in reports:
        senders += among(ids, np.intersect1d(report.controlled_ids, report.ids))
    velocities = fit.resized(low, high).factor * motion.velocities(template, template.points_of(ids))
    return np.asarray(velocities * rule.lead_s(motion.turn_radps, 1 / senders))


def drift_mps(
    motion: ShapeMotion, rule: LeadRule, *, template: Template, seen: Detections, center_px: complex
) -> Array:
    """Return the velocity (2,) along +u and +v, m/s, of the shape's point at a point of the image.

    It is 0 if the robots in the image define no similarity.

    Args:
        motion: rates of the shape.
        rule: response of the robots, with the side of their markers.
        template: the whole shape.
        seen: all robots of the team in the image.
        center_px: the point, u + iv.
    """
    try:
        fit = fit_similarity(template.points_of(seen.ids), to_complex(seen.centers_px))
    except DegenerateSetError:
        return np.zeros(2)
    point = (center_px - fit.target) / fit.factor + fit.source
    velocity_pxps = fit.factor * motion.velocities(template, np.array([point]))
    return np.asarray(to_points(velocity_pxps * rule.side_m / np.median(seen.sides_px))[0])
