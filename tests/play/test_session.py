"""Session of `skyherd play`: transport, interventions, undo, and saved scenarios that repeat it."""

from time import monotonic

import cv2
import numpy as np
import pytest

from skyherd import load_mission, run_steps
from skyherd.datasets import scenario_text
from skyherd.errors import InputError
from skyherd.play.session import (
    Change,
    End,
    Pause,
    Restart,
    Save,
    Session,
    SetSpeed,
    SingleStep,
    Undo,
)

PUSH = {"kind": "robot", "robot": 4, "position_m": [9.0, 1.0]}
ZOOM = {"kind": "camera", "unit": 0, "zoom": 1.3}
SHAPE = {"kind": "template", "shape": "circle"}


@pytest.fixture
def session(tmp_path):
    return Session.open("star", ["perception=ideal"], folder=tmp_path, speed=None)


def play(session, script, steps):
    """Return the first steps of a session, with requests by the number of the step after which they come."""
    seen = []
    for step in session.steps():
        seen.append(step)
        for request in script.get(len(seen), []):
            session.ask(request)
        if len(seen) == steps:
            session.ask(End())
    return seen


def lines(session):
    """Return the list that receives the session's lines."""
    said = []
    session.listen(said.append)
    return said


def assert_equal_steps(ours, theirs):
    for a, b in zip(ours, theirs, strict=True):
        assert a.time_s == b.time_s
        np.testing.assert_array_equal(a.positions_m, b.positions_m)
        np.testing.assert_array_equal(a.command.v_mps, b.command.v_mps)
        np.testing.assert_array_equal(a.fleet.zooms, b.fleet.zooms)


class TestTransport:
    def test_session_without_requests_gives_steps_of_the_loop(self, session):
        seen = play(session, {}, 30)
        assert_equal_steps(
            seen, list(run_steps(load_mission("star", ["perception=ideal", "duration_s=2.9"])))
        )

    def test_paused_session_steps_only_on_request(self, session):
        said = lines(session)
        script = {5: [Pause(True), SingleStep(), SingleStep(), Save(), Pause(False)]}
        seen = play(session, script, 9)
        assert [round(step.time_s, 6) for step in seen] == [round(0.1 * k, 6) for k in range(9)]
        assert "saved as" in " ".join(said)
        text = next(session._folder.glob("*.toml")).read_text()
        assert "duration_s = 100.0" in text

    def test_pause_holds_the_loop(self, session):
        """Requests of a paused session are handled, and the step between them stays the same."""
        times = []
        session.listen(lambda _: times.append(session._step.time_s))
        play(session, {3: [Pause(True), SetSpeed(1.0), SetSpeed(None), SingleStep()], 4: [Pause(False)]}, 6)
        assert times[:4] == pytest.approx([0.2] * 4)

    def test_restart_repeats_from_the_start_with_its_seed(self, tmp_path):
        session = Session.open("star", ["perception=noisy"], folder=tmp_path, speed=None)
        seen = play(session, {10: [Change((ZOOM,))], 20: [Restart(1)], 40: [Restart(7)]}, 60)
        unchanged = list(run_steps(load_mission("star", ["perception=noisy", "duration_s=1.9"])))
        assert_equal_steps(seen[20:40], unchanged)
        assert session.seed == 7 and not session.added
        assert (seen[59].positions_m != seen[39].positions_m).any()

    def test_speed_limits_the_steps_in_a_time(self, session):
        """Five steps of 0.1 s at four times the speed of time take at least 0.1 s."""
        session.speed = 4.0
        start_s = monotonic()
        play(session, {}, 6)
        assert monotonic() - start_s >= 0.1


class TestChanges:
    def test_change_is_made_before_the_next_step(self, session):
        seen = play(session, {10: [Change((ZOOM, PUSH))]}, 12)
        assert len(seen[10].interventions) == 2 and not seen[11].interventions
        assert seen[9].fleet.zooms[0] == 1.0 and seen[10].fleet.zooms[0] == 1.3
        np.testing.assert_array_equal(seen[10].positions_m[4], [9.0, 1.0])

    def test_changes_of_one_value_between_steps_are_merged(self, session):
        drags = [Change(({**ZOOM, "zoom": 1 + k / 100},)) for k in range(50)]
        seen = play(session, {10: [*drags, Change(({"kind": "camera", "unit": 0, "noise": 3.0},))]}, 12)
        (only,) = seen[10].interventions
        assert (only.zoom, only.noise) == (1.49, 3.0)

    @pytest.mark.parametrize(
        ("table", "said"),
        [
            ({**ZOOM, "zoom": 1e9}, "zoom"),
            ({**ZOOM, "unit": 9}, "no unit 9"),
            ({**PUSH, "robot": 77}, "no robot 77"),
            ({"kind": "template", "shape": "blob"}, "blob"),
            ({"kind": "template", "shape": "word:" + "W" * 50}, "word"),
            ({"kind": "control", "k_v": 1.0}, "unused"),
        ],
    )
    def test_impossible_change_is_told_and_not_made(self, session, table, said):
        told = lines(session)
        seen = play(session, {10: [Change((table,)), Change((ZOOM,))]}, 12)
        assert said in told[0] and told[1] == ""
        assert len(seen[10].interventions) == 1 and session.can_undo

    def test_undo_restores_what_was_before_a_drag(self, session):
        drag = [Change(({**ZOOM, "zoom": 1.1 + k / 100},)) for k in range(3)]
        script = {5: drag[:1], 6: drag[1:2], 7: drag[2:], 9: [Undo()], 10: [Undo()]}
        told = lines(session)
        seen = play(session, script, 12)
        assert [step.fleet.zooms[0] for step in seen[4:]] == [1, 1.1, 1.11, 1.12, 1.12, 1, 1, 1]
        assert told[-2] == "nothing to undo"

    @pytest.mark.parametrize(
        ("table", "restored"),
        [
            ({"kind": "unit", "unit": 1, "tilt_deg": [20.0, 0.0]}, {"tilt_deg": (0.0, 0.0)}),
            ({"kind": "camera", "unit": 1, "distortion": {"k1": -0.1}}, {"distortion": {"k1": 0.0}}),
            (
                {"kind": "camera", "unit": 1, "psf_px": 2.0, "frame_loss": 0.5},
                {"psf_px": 0.8, "frame_loss": 0},
            ),
            ({"kind": "cover", "marker": 3}, {"covered": False}),
            ({"kind": "kill", "unit": 1}, {"kind": "revive"}),
            ({"kind": "network", "message_loss": 0.5}, {"message_loss": 0.0}),
            ({"kind": "control", "k": 1.0}, {"k": 0.15}),
            (SHAPE, {"kind": "template"}),
        ],
    )
    def test_undo_restores_every_kind_of_value(self, session, table, restored):
        seen = play(session, {5: [Change((table,))], 8: [Undo()]}, 10)
        (undone,) = seen[8].interventions
        for key, value in restored.items():
            own = getattr(undone, key)
            assert (own.model_dump(include=value.keys()) if isinstance(value, dict) else own) == value

    def test_undone_shape_is_the_first_one_with_its_outline(self, session):
        seen = play(session, {5: [Change((SHAPE,))], 8: [Undo()]}, 10)
        template = session.mission.scenario.template
        assert seen[8].interventions[0].points == template.points
        assert seen[8].interventions[0].outline == template.outline


class TestSaved:
    def test_saved_scenario_repeats_the_session(self, tmp_path):
        script = {
            4: [Change((ZOOM,))],
            9: [Change(({"kind": "unit", "unit": 1, "tilt_deg": [12.0, -3.0], "position_m": [1.0, 2.0]},))],
            12: [Change((PUSH, {"kind": "cover", "marker": 3}))],
            15: [Undo()],
            20: [Change(({"kind": "kill", "unit": 2}, {"kind": "network", "message_loss": 0.4}))],
            25: [Change(({"kind": "control", "k": 0.3}, SHAPE))],
            30: [Change(({"kind": "revive", "unit": 2},))],
            40: [Save()],
        }
        session = Session.open(
            "star", ["perception=noisy", "duration_s=2"], seed=5, folder=tmp_path, speed=None
        )
        seen = play(session, script, 40)
        assert len(session.added) == 11
        mission = load_mission(str(tmp_path / "star-played.toml"))
        assert mission.scenario.duration_s == pytest.approx(3.9)
        again = list(run_steps(mission))
        assert_equal_steps(seen, again)

    def test_saved_scenario_differs_without_its_interventions(self, session):
        """Negative control of the comparison."""
        seen = play(session, {4: [Change((PUSH,))]}, 10)
        plain = list(run_steps(load_mission("star", ["perception=ideal", "duration_s=0.9"])))
        with pytest.raises(AssertionError):
            assert_equal_steps(seen, plain)

    def test_pictures_of_saved_scenario_have_full_paths(self, tmp_path):
        cv2.imwrite(str(tmp_path / "floor.png"), np.full((64, 64), 99, np.uint8))
        text = scenario_text("triangle") + '\n[ground]\nkind = "image"\nimage = "floor.png"\n'
        (tmp_path / "mine.toml").write_text(text)
        (tmp_path / "out").mkdir()
        session = Session.open(
            str(tmp_path / "mine.toml"), ["perception=ideal"], folder=tmp_path / "out", speed=None
        )
        play(session, {2: [Save()]}, 3)
        assert load_mission(str(tmp_path / "out" / "triangle-played.toml")).ground_image is not None


def test_invalid_scenario_or_folder_is_refused(tmp_path):
    for name, settings, folder in (
        ("sta", [], tmp_path),
        ("star", ["control.k=-1"], tmp_path),
        ("star", [], tmp_path / "none"),
    ):
        with pytest.raises(InputError):
            Session.open(name, settings, folder=folder)
