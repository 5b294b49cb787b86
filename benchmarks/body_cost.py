"""Measure the cost of roles, size and avoidance in a control step and in the robots' law, as ratios.

    OPENBLAS_NUM_THREADS=1 python benchmarks/body_cost.py

One unit sees 50 robots with bodies close together. The step with all parts is compared with the step without
them, on the same images. The laws of all 50 robots are compared after the same messages.
"""

from time import perf_counter

import numpy as np

from skyherd.control import Delivery
from skyherd.datasets import crowded_mission, make_mission
from skyherd.sim.agents import make_controller
from skyherd.sim.perception import make_perception
from skyherd.sim.physics import make_world
from skyherd.sim.robot_teams import make_team

ROBOTS, IMAGES, ROUNDS = 50, 40, 7


def tree(parts: bool) -> dict:
    """Return 50 robots under one unit that sees all of them, 0.7 m apart."""
    base = crowded_mission(3, units=1)
    rng = np.random.default_rng(1)
    grid = np.array([(x, y) for x in range(10) for y in range(5)], dtype=float) * 0.7
    places = grid + rng.uniform(-0.08, 0.08, grid.shape) - grid.mean(axis=0)
    base["robots"] |= {
        "positions_m": places.tolist(),
        "headings_deg": rng.uniform(-180, 180, ROBOTS).tolist(),
    }
    base["template"] = {"shape": "circle"}
    base["units"][0] |= {"position_m": [0.0, 0.0], "height_m": 8.0}
    if not parts:
        base |= {"roles": {}, "size": {}, "avoidance": {}}
    return base


def times_ms(parts: bool) -> tuple[float, float]:
    """Return the median times of a unit's step and of the team's command, ms."""
    mission = make_mission(tree(parts))
    controller, world = make_controller(mission, 0), make_world(mission)
    team = make_team(mission, world)
    perception = make_perception(mission, np.random.default_rng(0))
    steps, commands = [], []
    for image in range(IMAGES):
        time_s = 0.2 * image
        seen = perception.look(world, [0], time_s)[0].detections
        started = perf_counter()
        decision = controller.step(seen)
        steps.append(perf_counter() - started)
        messages = (m for m in (decision.goals, decision.proximity) if m is not None)
        delivered = [Delivery(message, np.ones(len(message), dtype=bool)) for message in messages]
        started = perf_counter()
        command = team.decide(time_s, delivered).command
        commands.append(perf_counter() - started)
        world.advance(command, time_s, 0.2)
    return 1e3 * float(np.median(steps)), 1e3 * float(np.median(commands))


def main() -> None:
    """Alternate both variants, so that other load affects them equally."""
    rounds = np.array([[times_ms(parts) for parts in (False, True)] for _ in range(ROUNDS)])
    without, with_parts = np.median(rounds, axis=0)
    for name, before, after in zip(("unit's step", "robots' laws"), without, with_parts, strict=True):
        print(f"{name:13} {before:6.3f} ms without, {after:6.3f} ms with all parts: {after / before:.2f} x")


if __name__ == "__main__":
    main()
