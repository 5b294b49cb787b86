"""Interventions in the loop: what each kind changes, and that runs with them repeat."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skyherd.datasets import (
    Intervention,
    Mission,
    load_mission,
    make_mission,
    read_interventions,
    read_scenario,
)
from skyherd.loop import Step, run_steps
from skyherd.recording.reader import read_messages, read_recording
from skyherd.recording.writer import McapRecorder
from skyherd.render import Camera, CameraPose, Ground, Imaging, Motion, Renderer, Sensor, Shot, Shutter

IDEAL = ("perception=ideal", "control.rectify=false")


def mission_of(name: str, tables: Sequence[dict[str, Any]], *settings: str) -> Mission:
    mission = load_mission(name, settings)
    tree = mission.scenario.model_dump(mode="json") | {"interventions": list(tables)}
    return make_mission(tree, folder=read_scenario(name).folder)


def messages(path: Path, mission: Mission, **arguments: Any) -> list[tuple[str, float, Any]]:
    """Record a run and return its messages after the mission's."""
    with McapRecorder(path, mission) as recorder:
        for step in run_steps(mission, **arguments):
            recorder.write(step)
        recorder.finish(step.time_s, 0.0)
    return [message for message in read_messages(path) if message[0] != "/mission"]


def steps_of(tables: Sequence[dict[str, Any]], *settings: str, name: str = "triangle") -> list[Step]:
    return list(run_steps(mission_of(name, tables, *IDEAL, *settings)))


EACH_KIND = [
    {"at_s": 0.0, "kind": "camera", "unit": 1, "frame_loss": 0.3},
    {"at_s": 0.3, "kind": "unit", "unit": 0, "position_m": [4.5, 5.5], "height_m": 17.0, "yaw_deg": 40.0},
    {"at_s": 0.3, "kind": "unit", "unit": 2, "tilt_deg": [5.0, -3.0]},
    {"at_s": 0.4, "kind": "camera", "unit": 0, "zoom": 1.1, "aspect": 1.05, "distortion": {"k1": -0.05}},
    {"at_s": 0.4, "kind": "camera", "unit": 1, "psf_px": 1.2, "noise": 4.0, "exposure_s": 0.02, "gain": 0.9},
    {"at_s": 0.5, "kind": "robot", "robot": 4, "position_m": [5.0, 5.0], "heading_deg": 90.0},
    {"at_s": 0.5, "kind": "cover", "marker": 3},
    {"at_s": 0.6, "kind": "network", "message_loss": 0.3, "delay_s": 0.2},
    {"at_s": 0.6, "kind": "kill", "unit": 2},
    {"at_s": 0.7, "kind": "control", "k": 0.4},
    {"at_s": 0.8, "kind": "template", "shape": "circle"},
    {"at_s": 0.9, "kind": "cover", "marker": 3, "covered": False},
    {"at_s": 0.9, "kind": "revive", "unit": 2},
]


class TestRecording:
    def test_messages_are_unchanged_until_first_intervention(self, tmp_path) -> None:
        settings = [*IDEAL, "duration_s=3"]
        late = [{"at_s": 2.0, "kind": "robot", "robot": 0, "position_m": [0.0, 0.0]}]
        plain = messages(tmp_path / "a.mcap", mission_of("triangle", [], *settings))
        moved = messages(tmp_path / "b.mcap", mission_of("triangle", late, *settings))
        assert "/interventions" not in {topic for topic, *_ in plain}
        assert [m for m in plain if m[1] < 1.99] == [m for m in moved if m[1] < 1.99]
        assert [m for m in plain if m[1] > 2.01] != [m for m in moved if m[1] > 2.01]

    @pytest.mark.smoke
    def test_two_runs_of_every_kind_give_equal_messages(self, tmp_path) -> None:
        small = ["units.*.camera={half_angle_deg = 35.0, size_px = [256, 256]}", "duration_s=1.2"]
        mission = mission_of("star", EACH_KIND, *small)
        one, two = (messages(tmp_path / f"{n}.mcap", mission) for n in range(2))
        assert one == two
        changes = [
            table for topic, _, body in one if topic == "/interventions" for table in body["interventions"]
        ]
        assert [table["kind"] for table in changes] == [table["kind"] for table in EACH_KIND]

    def test_recording_gives_the_interventions_of_each_step(self, tmp_path) -> None:
        mission = mission_of("star", EACH_KIND, *IDEAL, "duration_s=1.2")
        messages(tmp_path / "a.mcap", mission)
        recording = read_recording(tmp_path / "a.mcap")
        assert recording.whole and recording.mission.scenario == mission.scenario
        at = {round(step.time_s, 6): step.interventions for step in recording.steps if step.interventions}
        assert list(at) == sorted({table["at_s"] for table in EACH_KIND})
        assert [one for changes in at.values() for one in changes] == mission.scenario.interventions_in_order

    def test_requests_give_the_messages_of_a_scenario_with_them(self, tmp_path) -> None:
        """An operator asks for them step by step, without their times."""
        settings = [*IDEAL, "duration_s=1.2"]
        asked, times_s = read_interventions(EACH_KIND), dict[float, float]()

        def requests(time_s: float) -> list[Intervention]:
            times_s[round(time_s, 6)] = time_s
            return [one for one in asked if abs(one.at_s - time_s) < 1e-6]

        live = messages(tmp_path / "a.mcap", mission_of("star", [], *settings), requests=requests)
        exact = [table | {"at_s": times_s[table["at_s"]]} for table in EACH_KIND]
        replay = messages(tmp_path / "b.mcap", mission_of("star", exact, *settings))
        assert live == replay

    def test_outage_and_killed_unit_give_equal_messages(self, tmp_path) -> None:
        outage = mission_of("star", [], *IDEAL, "duration_s=3", "units.1.outages=[[1.0, 2.0]]")
        lives = [{"at_s": 1.0, "kind": "kill", "unit": 1}, {"at_s": 2.0, "kind": "revive", "unit": 1}]
        killed = mission_of("star", lives, *IDEAL, "duration_s=3")
        one = messages(tmp_path / "a.mcap", outage)
        two = [m for m in messages(tmp_path / "b.mcap", killed) if m[0] != "/interventions"]
        assert one == two and {m[1] for m in one if m[0] == "/unit/1/report"}.isdisjoint({1.0, 1.5})

    def test_shape_by_intervention_is_that_of_the_schedule(self, tmp_path) -> None:
        then = mission_of("triangle", [], *IDEAL, "duration_s=3", 'template.then=[{at_s=1, shape="line"}]')
        asked = [{"at_s": 1.0, "kind": "template", "shape": "line"}]
        one = messages(tmp_path / "a.mcap", then)
        two = messages(tmp_path / "b.mcap", mission_of("triangle", asked, *IDEAL, "duration_s=3"))
        assert one == [m for m in two if m[0] != "/interventions"]


class TestWorld:
    def test_robot_is_put_where_it_is_asked_to_be(self) -> None:
        table = {"at_s": 0.5, "kind": "robot", "robot": 2, "position_m": [3.0, -1.0], "heading_deg": 45.0}
        before, now, after = steps_of([table], "duration_s=0.6")[4:7]
        assert now.positions_m[2].tolist() == [3.0, -1.0] and now.headings_rad[2] == np.radians(45.0)
        np.testing.assert_array_equal(np.delete(before.positions_m - now.positions_m, 2, 0)[0] != 0, True)
        assert np.linalg.norm(after.positions_m[2] - now.positions_m[2]) < 0.11, "at most 1 m/s"
        assert before.positions_m[2].tolist() != [3.0, -1.0], "earlier steps keep their places"

    def test_heading_alone_leaves_the_place(self) -> None:
        table = {"at_s": 0.5, "kind": "robot", "robot": 2, "heading_deg": 45.0}
        plain, turned = steps_of([], "duration_s=0.5")[-1], steps_of([table], "duration_s=0.5")[-1]
        np.testing.assert_array_equal(plain.positions_m, turned.positions_m)
        assert turned.headings_rad[2] == np.radians(45.0) != plain.headings_rad[2]

    def test_unit_is_moved_turned_and_tilted(self) -> None:
        table = {"at_s": 0.5, "kind": "unit", "unit": 0, "position_m": [1.0, 2.0], "height_m": 14.0}
        table |= {"yaw_deg": 30.0, "tilt_deg": [10.0, -5.0]}
        fleet = steps_of([table], "duration_s=0.5")[-1].fleet
        assert (fleet.positions_m[0].tolist(), fleet.heights_m[0]) == ([1.0, 2.0], 14.0)
        np.testing.assert_allclose(np.degrees([fleet.yaws_rad[0], *fleet.tilts_rad[0]]), [30.0, 10.0, -5.0])

    def test_zoom_keeps_the_factor_of_the_unit_itself(self) -> None:
        """The prescribed ramp ends; the unit's own zoom of `keep-in-view` goes on from its value."""
        ramp = ["units.0.zoom=[[0, 1], [10, 2]]", "units.0.zoom_range=[0.5, 2]", "duration_s=2"]
        ramp += ["units.0.flight.kind=keep-in-view"]
        table = {"at_s": 1.0, "kind": "camera", "unit": 0, "zoom": 1.7}
        plain, other = steps_of([], *ramp), steps_of([table], *ramp)
        own = plain[10].fleet.zooms[0] / 1.1
        assert own != 1.0 and other[10].fleet.zooms[0] == pytest.approx(1.7 * own, rel=1e-12)

    def test_aspect_stretches_the_image_about_its_principal_point(self) -> None:
        table = {"at_s": 0.0, "kind": "camera", "unit": 0, "aspect": 1.2}
        plain, other = (steps_of(t, "duration_s=0.1")[0].frames[0].sight.detections for t in ([], [table]))
        middle = np.array([407.0, 392.0])
        stretched = (plain.centers_px - middle) * [1.0, 1.2] + middle
        np.testing.assert_allclose(other.centers_px, stretched, atol=1e-9)

    @pytest.mark.parametrize("perception", ["ideal", "rendered"])
    def test_covered_marker_is_not_seen_until_it_is_uncovered(self, perception: str) -> None:
        tables = [
            {"at_s": 0.2, "kind": "cover", "marker": 3},
            {"at_s": 0.4, "kind": "cover", "marker": 3, "covered": False},
        ]
        steps = steps_of(tables, "duration_s=0.5", f"perception={perception}")
        for step in steps:
            sight, covered = step.frames[0].sight, 0.15 < step.time_s < 0.35
            assert (3 not in sight.detections.ids) == (3 not in sight.whole_ids) == covered
            assert len(sight.detections) == 6 - covered

    def test_lost_frames_are_those_of_one_camera(self) -> None:
        table = {"at_s": 1.0, "kind": "camera", "unit": 1, "frame_loss": 1.0}
        steps = steps_of([table], "duration_s=2", name="star")
        taken = [[unit in step.frames for step in steps] for unit in range(3)]
        assert all(taken[0]) and all(taken[2]) and taken[1] == [True] * 10 + [False] * 11


class TestTeam:
    def test_gains_are_those_of_a_scenario_with_them(self) -> None:
        """From the same state, the commands are equal: at the first step there is no history."""
        table = {"at_s": 0.0, "kind": "control", "k": 0.3, "k_omega": 0.9, "b_th": 0.5}
        asked = steps_of([table], "duration_s=1")
        set_so = steps_of([], "duration_s=1", "control.k=0.3", "control.k_omega=0.9", "control.b_th=0.5")
        for one, other in zip(asked, set_so, strict=True):
            np.testing.assert_array_equal(one.command.v_mps, other.command.v_mps)
        assert (asked[5].command.v_mps != steps_of([], "duration_s=1")[5].command.v_mps).any()

    def test_lost_messages_stop_the_robots_by_their_watchdog(self) -> None:
        table = {"at_s": 1.0, "kind": "network", "message_loss": 1 - 1e-9}
        steps = steps_of([table], "duration_s=2", "robots.timeout_s=0.5")
        moving = [step.commanded_ids.size for step in steps]
        assert moving[:10] == [6] * 10 and moving[-4:] == [0] * 4

    def test_delay_makes_goals_late(self) -> None:
        """Goals of the step before may still arrive; robots without a fresh one stop."""
        table = {"at_s": 0.0, "kind": "network", "delay_s": 1000.0}
        assert not any(step.commanded_ids.size for step in steps_of([table], "duration_s=1"))

    def test_robot_dragged_away_comes_back(self) -> None:
        """After convergence it is dragged by 3 m in a second; the shape forms again as well as before."""
        faster = ["duration_s=45", "control.k=0.6", "control.k_omega=2.4"]
        x_m, y_m = steps_of([], *faster, "duration_s=20")[-1].positions_m[3].tolist()
        drag = [
            {
                "at_s": 20 + 0.1 * k,
                "kind": "robot",
                "robot": 3,
                "position_m": [x_m + 0.3 * k, y_m],
            }
            for k in range(1, 11)
        ]
        errors = {round(s.time_s, 3): s.metrics.shape.error for s in steps_of(drag, *faster)}
        assert errors[20.0] < 0.01 and errors[21.0] > 0.1 and errors[45.0] < 0.01, errors

    def test_own_robots_refuse_gains_in_one_line(self) -> None:
        table = {"at_s": 0.0, "kind": "control", "k": 0.3}
        mission = mission_of("triangle", [table], *IDEAL)

        class Still:
            def decide(self, time_s: float, delivered: Any) -> None:
                """Not reached: the gains are refused before."""

        with pytest.raises(
            ValueError, match=r"^interventions: robots of your own take no gains; no kind 'contr"
        ):
            next(iter(run_steps(mission, team_for=lambda mission, world: Still())))


def renderer(noise: float = 2.0, gain: float = 1.0, psf_px: float = 0.8, exposure_s: float = 0.0) -> Renderer:
    sensor = Sensor(noise, np.random.default_rng(5), gain=gain)
    shutter = Shutter(exposure_s=exposure_s)
    return Renderer("4X4_50", 1.0, Ground(0, kind="concrete"), sensor, psf_px=psf_px, shutter=shutter)


def shot_of(**given: Any) -> Shot:
    return Shot(
        Camera((160, 120), focal_px=150.0),
        CameraPose((0.0, 0.0), 8.0),
        np.array([3, 7]),
        np.array([[-1.0, 0.2], [1.2, -0.4]]),
        np.array([0.3, 1.9]),
        motion=Motion(camera_mps=(3.0, 0.0, 0.0)),
        **given,
    )


class TestImaging:
    @pytest.mark.parametrize(
        "values",
        [{"psf_px": 1.7}, {"exposure_s": 0.05}, {"gain": 0.8}, {"noise": 6.0}, {"noise": 0.0, "gain": 1.2}],
    )
    def test_values_of_one_camera_are_those_of_such_a_renderer(self, values: dict[str, float]) -> None:
        """The images are equal to the bit, since the sequence of random numbers is the same."""
        shot = shot_of(imaging=Imaging(**values))
        image = renderer().render(shot)
        np.testing.assert_array_equal(image, renderer(**values).render(shot_of()))
        assert (image != renderer().render(shot_of())).any()

    def test_skipped_images_take_the_random_numbers_of_drawn_ones(self) -> None:
        shots = [
            shot_of(stream=0),
            shot_of(stream=1, imaging=Imaging(noise=5.0)),
            shot_of(stream=2, imaging=Imaging(noise=0.0)),
        ]
        drawing, skipping = renderer(), renderer()
        for _ in range(3):
            for shot in shots:
                drawing.render(shot)
                skipping.skip(shot)
        np.testing.assert_array_equal(drawing.render(shots[0]), skipping.render(shots[0]))

    def test_truth_has_the_exposure_of_the_camera(self) -> None:
        shot = shot_of(imaging=Imaging(exposure_s=0.1))
        np.testing.assert_array_equal(
            renderer().truth(shot).centers_px, renderer(exposure_s=0.1).truth(shot_of()).centers_px
        )
