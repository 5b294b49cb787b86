"""Delay of a camera's images, from the motion in them and the motion that was commanded before."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from skyherd.control.team_view import TeamView
from skyherd.geometry import Array

RESPONSIVE = 0.2
"""Share of the commanded motion below which a robot does not respond. Derived: the quotient of `STILL_SIDES`
and `MOVED_SIDES` of `camera_check`."""

SAMPLE_S = 0.2
"""Minimum time between the images in which a delay is measured, s. Chosen: a robot at `MIN_PACE_SIDES_PS`
moves by ten times the noise of a centre meanwhile."""

MEMORY_S = 10.0
"""Maximum time of the images in which a delay is measured, s. Chosen: twice the time between two suspicions
of a camera late by 3 s."""

MAX_DELAY_S = 5.0
"""Largest delay that is measured, s. Chosen: above the buffers of encoders and networks."""

DELAY_STEP_S = 0.1
"""Step of the delays that are compared, s. Chosen: below the error of 0.3 s from unknown lags of robots."""

ALIKE = 0.7
"""Minimum cosine between the motion in the images and the commanded one for a delay. Measured: at least 0.87
in the lab `table` for cameras late by 1 to 3 s, and usually 0.8 in `triangle`, whose unit flies."""

UNLIKE = 0.9
"""Maximum cosine at the usual lags, relative to that at a delay. Measured: at most 0.65 for cameras late by
1.5 s or more, 0.93 for those late by 1 s, and 1.0 for those late by 0.7 s or frozen."""

CommandedSides = Callable[[Array, Array], Array]
"""Function from the begins and ends (...) of time spans, s, to commanded motions (..., N), marker sides."""


def measured_delay_s(
    views: Sequence[TeamView], commanded_sides: CommandedSides, max_speed_sides_ps: float, max_lag_s: float
) -> float:
    """Return the delay at which the motion in the last images follows the commands, s; 0 for none.

    With the motions o in the images and the commanded motions c(d) of d seconds before, of all robots in
    all intervals between images, it is the d of the largest cosine o · c(d) / |o| |c(d)|. It is 0 unless
    that is at least `ALIKE`, and all cosines within the longest lag of the loop are below it (`UNLIKE`).
    Motions count in the image, as of a camera at rest, or relative to the other robots, as of one that
    flies, whichever agree better. They count up to the top speed: a camera that was frozen shows a jump.

    Args:
        views: the last images, at least `SAMPLE_S` apart.
        commanded_sides: commanded motions (..., N), marker sides, from some times (...) to others, s.
        max_speed_sides_ps: top speed of the robots, marker sides per second.
        max_lag_s: longest time from an image to the visible effect of its goals.
    """
    if len(views) < 2:
        return 0.0
    everyone = np.ones(views[0].seen.size, dtype=bool)
    moved = [view.moved_sides(last) for last, view in pairwise(views)]
    relative = [view.relative_sides(last, everyone) for last, view in pairwise(views)]
    times_s = np.array([view.time_s for view in views])
    reach_sides = max_speed_sides_ps * np.diff(times_s)[:, None]
    seen = np.minimum([moved, relative], reach_sides)
    delays_s = np.arange(0.0, MAX_DELAY_S + DELAY_STEP_S / 2, DELAY_STEP_S)
    ends_s = times_s - delays_s[:, None]
    commanded = commanded_sides(ends_s[:, :-1], ends_s[:, 1:])
    seen_norms = np.linalg.norm(seen, axis=(1, 2))[:, None]
    norms = np.linalg.norm(commanded, axis=(1, 2))
    products = np.einsum("vkn,dkn->vd", seen, commanded)
    responds = (norms > 0) & (seen_norms >= RESPONSIVE * norms)
    cosines = np.divide(products, seen_norms * norms, out=np.zeros(products.shape), where=responds)
    kind, best = np.unravel_index(np.argmax(cosines), cosines.shape)
    usual = float(np.max(cosines[kind, delays_s <= max_lag_s]))
    is_late = cosines[kind, best] >= ALIKE and usual <= UNLIKE * cosines[kind, best]
    return float(delays_s[best]) if is_late else 0.0
