"""Scripts of examples/: their output is correct."""

import importlib.util
from pathlib import Path

import numpy as np

from skyherd.datasets import load_mission
from skyherd.files.video_writer import VideoSink
from skyherd.loop import run_steps

EXAMPLES = Path(__file__).parent.parent / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_own_world_example_ends_in_square_and_is_short():
    corners = load("bring_your_own_world").main()
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    diagonals = np.linalg.norm(corners[2:] - corners[:2], axis=1)
    # Positions come from markers of 32 px seen at 80 px a metre: an error of 0.5 px is 6 mm on sides of 4 m.
    np.testing.assert_allclose(sides, sides.mean(), rtol=0.005)
    np.testing.assert_allclose(diagonals, np.sqrt(2) * sides.mean(), rtol=0.005)
    assert len((EXAMPLES / "bring_your_own_world.py").read_text().splitlines()) < 60


def test_recorded_video_example_gives_goals_of_the_run(tmp_path):
    mission = load_mission(
        "circle",
        ["duration_s=0.1", "selection.radius=1.2", "units.0.height_m=18", "units.0.flight.kind=hover"],
    )
    steps = list(run_steps(mission))
    with VideoSink(tmp_path / "camera.mp4", (800, 800), 10) as sink:
        for step in steps:
            sink.write(np.repeat(step.frames[0].sight.image[..., None], 3, axis=2))
    found, decision = next(iter(load("recorded_video").decisions(str(tmp_path / "camera.mp4"), "circle", 12)))
    sent = steps[0].frames[0]
    assert found == len(sent.sight.detections)
    assert decision.goals.ids.tolist() == sent.decision.goals.ids.tolist()
    # The codec moves an edge by some tenths of a pixel.
    np.testing.assert_allclose(decision.goals.rho_px, sent.decision.goals.rho_px, atol=1.0)


def test_evolution_strategy_finds_maximum_of_rotated_ellipsoid():
    """Seven parameters, axes with scales of 1 to 10. A random search of as many trials stays far away."""
    example, best = load("learn_formation"), np.linspace(-1, 1, 7)
    axes = np.linalg.qr(np.random.default_rng(1).standard_normal((7, 7)))[0] * np.linspace(1, 10, 7)

    def score(theta, generation):
        return -float(((theta - best) @ axes) @ ((theta - best) @ axes))

    found = list(example.evolve(score, np.zeros(7), 150, seed=2))
    np.testing.assert_allclose(found[-1], best, atol=1e-3)
    again = list(example.evolve(score, np.zeros(7), 150, seed=2))
    np.testing.assert_array_equal(found, again)
    tried = np.random.default_rng(3).uniform(-1, 1, (150 * 9, 7))
    assert max(score(theta, 0) for theta in tried) < -0.1


def test_policy_before_learning_forms_the_shape_like_the_law():
    """Its gains are those of the law, and its repulsion is near 0."""
    example = load("learn_formation")
    env = example.make_env("anywhere", 10.0, {"avoidance.on": False})
    scores = [
        example.episode(env, 1, policy) for policy in (example.built_in, example.learned(example.START))
    ]
    still = example.episode(env, 1, lambda seen, infos: {agent: np.zeros(2) for agent in seen})
    assert scores[1] > still + 0.8 * (scores[0] - still)


def test_survey_example_can_be_surveyed(tmp_path):
    """The first two pictures show all six markers, the third five; the calibration is that of the camera."""
    from skyherd.poses import read_calibration
    from skyherd.survey import survey, take_views

    load("survey_pictures").main(tmp_path)
    pictures = sorted(tmp_path.glob("view*.png"))
    views = take_views(pictures, [str(tmp_path / "camera.yaml")], dictionary="4X4_50")
    assert [view.ids.tolist() for view in views] == [list(range(6))] * 2 + [[0, 1, 2, 3, 5]]
    assert read_calibration(str(tmp_path / "camera.yaml")).matrix[0, 0] == 900.0
    assert survey(views, 0.1, coplanar=True).frame.consistent
