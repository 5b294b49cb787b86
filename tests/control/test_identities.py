"""A robot is told from copies of its marker by the turn that the unit asks for."""

import numpy as np
import pytest

from skyherd.control.identities import (
    AMBIGUOUS_S,
    ASKED_S,
    COPY_ID,
    PAUSE_S,
    RESTED_RAD,
    TURNED_RAD,
    Copies,
    Turns,
)
from skyherd.control.robots.unicycle import MarkerGains, Wheels, wheel_law

ROBOT, OTHERS = 3, (0, 1, 2)
PERIOD_S, SIDE_PX = 0.1, 20.0
TURN_RADPS = 3.0


class Scene:
    """Images of a robot with the id 3, of copies of its marker, and of three other robots.

    The camera moves and turns, so that all markers do in the image.
    """

    def __init__(self, make_detections, *, copies: int = 1, yaw_radps: float = 0.0) -> None:
        self._make, self._copies, self._yaw_radps = make_detections, copies, yaw_radps
        self.heading_rad, self.time_s, self.at = 0.7, 0.0, 300 + 300j
        self.labels = Copies()

    def look(self, left_radps: float = 0.0, *, robot: bool = True, copies: bool = True, copy_radps=0.0):
        """Return the relabelled detections after one period in which the robot turned left."""
        self.time_s += PERIOD_S
        self.heading_rad -= left_radps * PERIOD_S
        turned = self._yaw_radps * self.time_s
        rows = [(other, 100 + 150j * other, 0.3) for other in OTHERS]
        if copies:
            copy_rad = 0.5 - copy_radps * self.time_s
            rows += [(ROBOT, 500 + 100j * k, copy_rad) for k in range(self._copies)]
        if robot:
            rows.append((ROBOT, self.at, self.heading_rad))
        ids, points, headings = map(np.array, zip(*rows, strict=True))
        points = (points - 400) * np.exp(1j * turned) + 400 + 12 * self.time_s
        seen = self._make(
            ids, points, headings=headings + turned, sides=np.full(ids.size, SIDE_PX), time_s=self.time_s
        )
        return self.labels.relabel(seen)

    def robots_at(self, seen) -> list[complex]:
        """Return the places of all detections with the robot's id."""
        return [complex(*marker.center_px) for marker in seen if marker.id == ROBOT]


def turn(scene: Scene, by_rad: float, **changes):
    """Return the detections after the robot has turned to the left by an angle."""
    for _ in range(round(abs(by_rad) / TURN_RADPS / PERIOD_S)):
        seen = scene.look(np.copysign(TURN_RADPS, by_rad), **changes)
    return seen


@pytest.mark.parametrize("copies", [1, 3])
@pytest.mark.parametrize("yaw_radps", [0.0, 0.1, -0.1])
def test_marker_that_turns_is_the_robot(make_detections, copies, yaw_radps) -> None:
    scene = Scene(make_detections, copies=copies, yaw_radps=yaw_radps)
    assert (scene.look().ids == ROBOT).sum() == copies + 1
    seen = turn(scene, 2 * TURNED_RAD)
    robot = next(marker for marker in seen if marker.id == ROBOT)
    assert seen.ids.tolist() == [*OTHERS, ROBOT, *[COPY_ID + ROBOT] * copies]
    moved = np.exp(1j * yaw_radps * scene.time_s)
    assert complex(*robot.center_px) == pytest.approx(
        (scene.at - 400) * moved + 400 + 12 * scene.time_s, abs=1e-9
    )


@pytest.mark.parametrize(
    ("by_rad", "yaw_radps", "copy_radps"),
    [
        (0.8 * TURNED_RAD, 0.0, 0.0),  # too little
        (-3 * TURNED_RAD, 0.0, 0.0),  # to the other side
        (2 * TURNED_RAD, 0.0, TURN_RADPS),  # two robots have the id, and both obey
        (2 * TURNED_RAD, -3 * RESTED_RAD, 0.0),  # the camera turns as well
    ],
)
def test_without_clear_response_id_stays_ambiguous(make_detections, by_rad, yaw_radps, copy_radps) -> None:
    scene = Scene(make_detections, yaw_radps=yaw_radps)
    scene.look()
    seen = turn(scene, by_rad, copy_radps=copy_radps)
    assert seen.ids.tolist() == [*OTHERS, ROBOT, ROBOT]


def test_copy_stays_copy_while_the_robot_is_out_of_view(make_detections) -> None:
    scene = Scene(make_detections)
    scene.look()
    turn(scene, 2 * TURNED_RAD)
    for _ in range(round(2 * AMBIGUOUS_S / PERIOD_S)):
        assert scene.look(robot=False).ids.tolist() == [*OTHERS, COPY_ID + ROBOT]
    scene.at = 200 + 250j
    seen = scene.look()
    assert seen.ids.tolist() == [*OTHERS, ROBOT, COPY_ID + ROBOT]
    assert complex(*seen[3].center_px) == pytest.approx(200 + 250j + 12 * scene.time_s)


def test_roles_are_forgotten_after_both_were_out_of_view(make_detections) -> None:
    scene = Scene(make_detections)
    scene.look()
    turn(scene, 2 * TURNED_RAD)
    for _ in range(round(AMBIGUOUS_S / PERIOD_S) + 2):
        scene.look(robot=False, copies=False)
    assert scene.look().ids.tolist() == [*OTHERS, ROBOT, ROBOT]


def test_robot_that_was_missed_is_found_at_a_new_place(make_detections) -> None:
    scene = Scene(make_detections)
    scene.look()
    turn(scene, 2 * TURNED_RAD)
    scene.look(robot=False)
    scene.at += 1.5 * SIDE_PX
    for _ in range(3):
        seen = scene.look()
        assert seen.ids.tolist() == [*OTHERS, ROBOT, COPY_ID + ROBOT]
        assert complex(*seen[3].center_px) == pytest.approx(scene.at + 12 * scene.time_s)


def test_new_marker_beside_the_robot_is_a_copy(make_detections) -> None:
    scene = Scene(make_detections)
    scene.look(copies=False)
    scene.look()
    turn(scene, 2 * TURNED_RAD)
    scene._copies = 2
    assert scene.look().ids.tolist() == [*OTHERS, ROBOT, COPY_ID + ROBOT, COPY_ID + ROBOT]


def test_images_without_repeated_ids_are_returned_unchanged(make_detections) -> None:
    seen = make_detections([5, 2], [100, 200])
    assert Copies().relabel(seen) is seen


class TestTurns:
    def test_goal_turns_robot_to_the_left_in_place(self, make_detections) -> None:
        """The law drives by less than a third of a marker side while it turns by `TURNED_RAD`."""
        side_m, gains = 0.4, MarkerGains(0.4, 2.0, 0.0, 0.4)
        goals = Turns().ask(make_detections([3, 3, 0], [1, 200, 300]), {3})
        assert goals.ids.tolist() == [3]
        rho = goals.rho_px / goals.sides_px * np.exp(1j * goals.bearings_rad)
        v_mps, omega_radps = wheel_law(rho, gains, Wheels(0.6, TURN_RADPS))
        assert omega_radps[0] == TURN_RADPS and abs(v_mps[0]) * TURNED_RAD / TURN_RADPS < side_m / 3

    def test_requests_end_and_begin_again(self, make_detections) -> None:
        turns, period_s = Turns(), 0.5
        asked = [
            turns.ask(make_detections([3, 3], [1, 200], time_s=period_s * k), {3}) is not None
            for k in range(round((ASKED_S + PAUSE_S + 1) / period_s))
        ]
        assert sum(asked) == (ASKED_S + 1) / period_s and not any(asked[20:80])

    def test_absent_or_clear_robot_is_not_asked(self, make_detections) -> None:
        turns = Turns()
        assert turns.ask(make_detections([0, 1], [1, 200]), {3}) is None
        assert turns.ask(make_detections([0, 1], [1, 200]), ()) is None
