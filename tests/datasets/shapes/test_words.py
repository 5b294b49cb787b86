"""Words as shapes: room for every robot, robots at ends and corners, and refusal of too few robots."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist

from skyherd.datasets import load_mission, shape_points
from skyherd.datasets.shapes.letters import STROKES
from skyherd.datasets.shapes.words import MIN_SPACING, TURN_DEG, Stroke
from skyherd.errors import InputError

WORDS = ["SKY", "HERD", "QUIZ", "BOX8", "WAVY", "JUMP", "2026", "FLOCK", "II", "AMK4", "95317"]


def min_count(text: str) -> int:
    """Return the minimum number of robots that write a text, from the error for two robots."""
    try:
        shape_points(f"word:{text}", 2)
    except InputError as error:
        return int(error.allowed.split()[2])
    return 2


def sampled(text: str, step: float = 0.001) -> np.ndarray:
    """Return closely spaced points (M, 2) along all strokes of a letter."""
    points = []
    for curve in STROKES[text]:
        along = np.append(0.0, np.cumsum(np.abs(np.diff(curve))))
        at = np.linspace(0.0, along[-1], int(along[-1] / step) + 2)
        points.append(np.column_stack([np.interp(at, along, curve.real), np.interp(at, along, curve.imag)]))
    return np.concatenate(points)


def test_every_letter_is_there_and_fits_its_box() -> None:
    assert set(STROKES) == set("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789")
    for letter, curves in STROKES.items():
        points = np.concatenate(curves)
        assert points.real.min() == pytest.approx(0.0, abs=0.04), letter
        assert points.real.max() <= 1.2, letter
        assert points.imag.max() == pytest.approx(1.0, abs=0.03), letter
        assert points.imag.min() == pytest.approx(0.0, abs=0.1), letter


def test_strokes_have_no_corner_within() -> None:
    """Arcs turn by 3 degrees at each vertex; ellipses with different radii by at most twice as much."""
    for letter, curves in STROKES.items():
        for curve in curves:
            turns = np.degrees(np.angle(np.diff(curve)[1:] / np.diff(curve)[:-1]))
            assert np.abs(turns).max(initial=0.0) < 12, letter


@pytest.mark.parametrize("letter", sorted(STROKES))
def test_robots_stand_on_strokes_with_spacing_for_any_count(letter: str) -> None:
    """No two are nearer than 0.6 of the mean spacing, which is at least `length / (N + strokes)`."""
    length = sum(Stroke(curve, (0, 0)).length for curve in STROKES[letter])
    tree, least = cKDTree(sampled(letter)), min_count(letter)
    assert 2 <= least <= 12
    for count in range(least, 60):
        points = shape_points(f"word:{letter}", count)
        assert points.shape == (count, 2)
        assert pdist(points).min() >= MIN_SPACING * length / (count + len(STROKES[letter]))
        assert tree.query(points)[0].max() < 0.002
        for curve in STROKES[letter]:
            for end in (curve[0], curve[-1]):
                assert np.hypot(*(points - [end.real, end.imag]).T).min() < 1e-9, "ends and corners are taken"


@pytest.mark.parametrize("letter", sorted(STROKES))
def test_the_strokes_are_covered_without_gaps(letter: str) -> None:
    """With 12 robots no point of a letter is farther from one than 0.75 of the mean spacing.

    Webster's rule makes parts of at most 1.5 times their mean, and the nearer end is within half a part.
    """
    length = sum(Stroke(curve, (0, 0)).length for curve in STROKES[letter])
    points = shape_points(f"word:{letter}", 12)
    parts = 12 - len({complex(np.round(end, 6)) for c in STROKES[letter] for end in (c[0], c[-1])})
    parts += len(STROKES[letter])
    assert cKDTree(points).query(sampled(letter))[0].max() <= 0.75 * length / parts + 0.002


def test_curves_are_seen_to_be_curves() -> None:
    """With the minimum number of robots, the turn between two of them is within the limit: O is a hexagon."""
    assert min_count("O") == 6 == np.ceil(360 / TURN_DEG)
    points = shape_points("word:O", 6)
    angles = np.unwrap(np.arctan2(points[:, 1] - 0.5, points[:, 0] - 0.42))
    assert np.abs(np.diff(angles)).max() < np.radians(90)


@pytest.mark.parametrize("text", WORDS)
def test_words_have_room_too_and_read_from_left_to_right(text: str) -> None:
    least = min_count(text)
    for count in (least, least + 1, 2 * least, 12 * len(text)):
        points = shape_points(f"word:{text}", count)
        nearest = cKDTree(points).query(points, k=2)[0][:, 1]
        assert nearest.min() >= MIN_SPACING * 0.75 * np.median(nearest)
        assert len(np.unique(points.round(6), axis=0)) == count
    gaps = np.diff(np.sort(points[:, 0]))
    assert (gaps > 0.35).sum() >= len(text) - 1, "letters are told apart"
    with pytest.raises(InputError, match=rf"{least - 1} robots to write {text}; at least {least} robots"):
        shape_points(f"word:{text}", least - 1)


@pytest.mark.parametrize("name", ["word:", "word:sky", "word:A B", "word:Ä", f"word:{41 * 'A'}"])
def test_what_cannot_be_written_is_said_in_one_line(name: str) -> None:
    with pytest.raises(InputError, match=r"letters A-Z and digits") as caught:
        shape_points(name, 30)
    assert "\n" not in str(caught.value)


def test_a_scenario_may_ask_for_a_word() -> None:
    settings = ["template.shape=word:SKY", "robots.count=36", "marker.dictionary=5X5_100"]
    mission = load_mission("grid", settings)
    assert mission.ids.size == 36
    with pytest.raises(InputError, match=r"settings: template\.shape: 9 robots to write SKY.*at least 20"):
        load_mission("grid", [*settings, "robots.count=9"])
    with pytest.raises(InputError, match=r"one of circle, .*word:SKY"):
        load_mission("grid", ["template.shape=blob"])
