"""Measure what an operator reads about a camera whose images are late or frozen, although they seem fresh.

    python benchmarks/late_images.py

Live teams run in memory (`live_faults.py`) at ten images a second. The stream has no clock. It is late from
the start, before robots drive, or it shows one image for a while and is live again.
"""

import argparse
import re
from collections.abc import Callable

import numpy as np
from live_faults import Team

from skyherd.live.lab import load_lab

LABS = {"table": "[-30.0, 0.0]", "triangle": "[3.0,2.0]"}
"""Labs with the tilt of the simulated camera, deg."""

DELAYS_S = (0.7, 1.0, 1.5, 2.0, 3.0)
FREEZES_S = (2.0, 3.0, 4.0)
DURATION_S = 25.0
FROZEN_FROM_S = (3.0, 4.5)
"""Starts of freezes, s. Chosen: robots drive."""

DELAY = re.compile(r"images are late: .* after about (\S+) s")


def late(team: Team, delay_s: float) -> None:
    """Delay the images of a team."""
    team.delay_s = delay_s


def frozen(team: Team, from_s: float, for_s: float) -> None:
    """Repeat the image of one time for a while."""
    team.delay_s = team.time_s - from_s if from_s <= team.time_s < from_s + for_s else 0.0


def told(lab: str, seed: int, fault: Callable[[Team], None]) -> tuple[bool, list[float], float]:
    """Return whether the unit latched its suspicion, the delays that it named, s, and the longest way.

    The way is that of one robot since the first suspicion, marker sides.
    """
    settings = ["control.k=0.3", "control.k_omega=1.2"]
    team = Team(load_lab(lab, settings), [f"units.*.tilt_deg={LABS[lab]}"], seed, scenario_name=lab)
    unit, ways_m = team.processes["unit/0"], np.zeros(len(team.lab.ids))
    while team.time_s < DURATION_S:
        fault(team)
        before_m = team.world.positions_m.copy()
        team.step()
        ways_m += bool(unit.told) * np.linalg.norm(team.world.positions_m - before_m, axis=1)
    said = [line for line in unit.told if "image" in line]
    delays_s = [float(found[1]) for line in said if (found := DELAY.search(line))]
    return (
        "times within" in said[-1] if said else False,
        delays_s,
        ways_m.max() / team.lab.model.markers.side_m,
    )


def row(lab: str, words: str, seeds: int, faults: list[Callable[[Team], None]]) -> str:
    """Return the line of a table about several runs."""
    runs = [told(lab, seed, fault) for fault in faults for seed in range(seeds)]
    latched, named = sum(one[0] for one in runs), sum(bool(one[1]) for one in runs)
    delays_s = [delay_s for one in runs for delay_s in one[1]]
    spread = f"{min(delays_s):.1f}–{max(delays_s):.1f}" if delays_s else ""
    longest = max(one[2] for one in runs)
    return f"| `{lab}` | {words} | {len(runs)} | {latched} | {named} | {spread} | {longest:.1f} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    seeds = parser.parse_args().seeds
    print("| lab | images | runs | latched | delay named | delay named, s | way after, sides |")
    print("|" + "---|" * 7)
    for lab in LABS:
        for delay_s in DELAYS_S:
            print(row(lab, f"late by {delay_s:g} s", seeds, [lambda team, by_s=delay_s: late(team, by_s)]))
        for for_s in FREEZES_S:
            faults = [
                lambda team, from_s=from_s, for_s=for_s: frozen(team, from_s, for_s)
                for from_s in FROZEN_FROM_S
            ]
            print(row(lab, f"frozen for {for_s:g} s", seeds, faults), flush=True)


if __name__ == "__main__":
    main()
