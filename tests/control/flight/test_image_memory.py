"""Positions of robots outside a unit's view: from other units, updated by the unit's own motion."""

import numpy as np
import pytest

from skyherd.control import Template
from skyherd.control.flight.image_memory import ImageMemory

ROUNDING_PX = 1e-9
"""Similarities through some hundred pixels, fitted and applied: 1e-16 of them, some ten times."""
NO_ID: list[int] = []


def scene(seed: int, count: int = 9):
    """Return ground points, and the similarities of two cameras above them."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-3, 3, count) + 1j * rng.uniform(-3, 3, count)
    cameras = [
        (rng.uniform(60, 150) * np.exp(1j * rng.uniform(-3, 3)), complex(*rng.uniform(300, 500, 2)))
        for _ in range(2)
    ]
    template = Template(
        np.arange(10, 10 + count), rng.standard_normal(count) + 1j * rng.standard_normal(count)
    )
    return (
        rng,
        ground,
        [lambda at, turn=turn, shift=shift: turn * at + shift for turn, shift in cameras],
        template,
    )


def known_points(memory: ImageMemory, ids) -> np.ndarray:
    rows = memory.rows(np.asarray(ids))
    assert memory.known[rows].all()
    return memory.points_px[rows]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("common", [2, 5])
def test_image_memory_places_robot_outside_frame(make_detections, make_report, seed, common) -> None:
    """Two common robots determine the similarity; the reference is the unit's own camera."""
    _, ground, (ours, theirs), template = scene(seed)
    ids = template.ids
    memory = ImageMemory(template)
    report = make_report(1, ids, theirs(ground), NO_ID)
    memory.update(make_detections(ids[:common], ours(ground[:common])), [report])
    np.testing.assert_allclose(known_points(memory, ids), ours(ground), rtol=0, atol=ROUNDING_PX)
    assert memory.seen_s[memory.rows(ids[common:])].max() == -np.inf, "placed, not seen"


@pytest.mark.parametrize("seed", range(8))
def test_image_memory_places_other_units_image_center(make_detections, make_report, seed) -> None:
    _, ground, (ours, theirs), template = scene(seed)
    memory = ImageMemory(template)
    size = (640, 480)
    report = make_report(1, template.ids, theirs(ground), NO_ID, size=size)
    memory.update(make_detections(template.ids[:4], ours(ground[:4])), [report])
    turn = theirs(1.0) - theirs(0.0)
    middle = (complex(319.5, 239.5) - theirs(0.0)) / turn
    assert memory.centers_px[1] == pytest.approx(ours(middle), abs=ROUNDING_PX)
    memory.update(make_detections(template.ids[:4], ours(ground[:4]), time_s=1.0), [])
    assert not memory.centers_px, "known only by reports"


@pytest.mark.parametrize("seed", range(8))
def test_image_memory_moves_points_with_unit(make_detections, seed) -> None:
    """The camera turns, climbs and drifts for thirty images; robots unseen since the first image are static.

    Rounding accumulates image by image.
    """
    rng, ground, (camera, _), template = scene(seed)
    memory = ImageMemory(template)
    memory.update(make_detections(template.ids, camera(ground)), [])
    for tick in range(1, 31):
        turn = 1 + 0.03 * complex(*rng.standard_normal(2))
        shift = complex(*rng.standard_normal(2)) * 5
        camera = lambda at, before=camera, turn=turn, shift=shift: turn * before(at) + shift  # noqa: E731
        memory.update(make_detections(template.ids[:3], camera(ground[:3]), time_s=0.1 * tick), [])
    np.testing.assert_allclose(
        known_points(memory, template.ids), camera(ground), rtol=0, atol=100 * ROUNDING_PX
    )
    np.testing.assert_array_equal(memory.seen_s, [3.0] * 3 + [0.0] * 6)


def test_image_memory_ignores_single_common_robot(make_detections, make_report) -> None:
    """One robot determines neither the similarity to another image nor the own motion."""
    _, ground, (ours, theirs), template = scene(1)
    memory = ImageMemory(template)
    report = make_report(1, template.ids, theirs(ground), NO_ID)
    memory.update(make_detections(template.ids[:1], ours(ground[:1])), [report])
    assert memory.known.tolist() == [True] + [False] * 8 and not memory.centers_px
    before = known_points(memory, template.ids[:1])
    memory.update(make_detections([], [], time_s=1.0), [])
    assert known_points(memory, template.ids[:1]) == before


def test_image_memory_ignores_coincident_common_robots(make_detections, make_report) -> None:
    _, ground, (ours, theirs), template = scene(2)
    memory = ImageMemory(template)
    theirs_px = theirs(ground)
    theirs_px[1] = theirs_px[0]
    memory.update(
        make_detections(template.ids[:2], ours(ground[:2])), [make_report(1, template.ids, theirs_px, NO_ID)]
    )
    assert memory.known.sum() == 2


def test_image_memory_centred_points_are_in_half_images(make_detections) -> None:
    """Robots without a known position are omitted."""
    template = Template(np.arange(4), np.array([0, 1, 1j, 2]))
    memory = ImageMemory(template)
    seen = make_detections([0, 2], [399.5 + 399.5j, 799.5 + 199.5j])
    memory.update(seen, [])
    np.testing.assert_allclose(
        memory.centred(np.array([0, 1, 2]), seen.image_size_px), [[0, 0], [1.0, -0.5]], atol=1e-12
    )


@pytest.mark.parametrize("first", [1, 2])
def test_image_memory_places_units_through_chain(make_detections, make_report, first) -> None:
    """Unit 2 shares robots with unit 1 alone, in any order of reports; unit 3 with no unit."""
    _, ground, (ours, theirs), template = scene(3)
    ids = template.ids
    seen = {1: slice(2, 6), 2: slice(4, 8), 3: slice(8, 9)}
    reports = {
        unit: make_report(unit, ids[part], (unit + 1j) * theirs(ground[part]), NO_ID)
        for unit, part in seen.items()
    }
    memory = ImageMemory(template)
    ours_now = make_detections(ids[:4], ours(ground[:4]))
    memory.update(ours_now, [reports[first], reports[3 - first], reports[3]])
    np.testing.assert_allclose(known_points(memory, ids[:8]), ours(ground[:8]), rtol=0, atol=1e-8)
    assert not memory.known[8]
    assert set(memory.centers_px) == {1, 2}


def test_two_robots_determine_own_motion_and_one_does_not(make_detections) -> None:
    """The unit moves by 30 px; robots 12 to 18 leave the view, and only two, or one, of the known remain."""
    _, ground, (ours, _), template = scene(3)
    for remaining, moves in ((2, True), (1, False)):
        memory = ImageMemory(template)
        memory.update(make_detections(template.ids, ours(ground)), [])
        ids = template.ids[:remaining]
        memory.update(make_detections(ids, ours(ground[:remaining]) + 30, time_s=1.0), [])
        moved = known_points(memory, template.ids[2:]) - ours(ground[2:])
        np.testing.assert_allclose(moved, 30.0 if moves else 0.0, rtol=0, atol=ROUNDING_PX)


@pytest.mark.parametrize("unknown", [0, 13, 2**62])
def test_image_memory_ignores_ids_beyond_the_template(make_detections, make_report, unknown) -> None:
    """Such an id once fell into the row of another robot, or beyond the last one."""
    _, ground, (ours, theirs), whole = scene(0)
    template = Template(np.delete(whole.ids, 3), np.delete(whole.points_px, 3))
    memory, seen = ImageMemory(template), make_detections(template.ids[:3], ours(ground[:3]))
    ids = [*template.ids[:3], unknown, *template.ids[3:-1]]
    points = np.array([*ground[:3], 5j, *np.delete(ground, 3)[3:-1]])
    memory.update(seen, [make_report(1, ids, theirs(points), NO_ID)])
    np.testing.assert_allclose(
        known_points(memory, template.ids[:-1]), ours(np.delete(ground, 3)[:-1]), rtol=0, atol=ROUNDING_PX
    )
    assert not memory.known[-1]
