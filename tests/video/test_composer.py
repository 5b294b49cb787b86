from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import cache, partial
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from skyherd.analysis.goal_points import desired_points_px
from skyherd.datasets import Mission, load_mission
from skyherd.drawing.canvas import text_width, wrap_text
from skyherd.drawing.palette import TEMPLATE_COLOR, rgb, unit_rgb
from skyherd.errors import OutputError
from skyherd.files.video_writer import VideoSink, count_frames, read_frames
from skyherd.geometry import to_complex
from skyherd.loop import Step, run_steps
from skyherd.video.axis_ticks import LinearRange, LogRange, tick_values
from skyherd.video.camera_panel import CameraPanel, brightened
from skyherd.video.composer import Composer
from skyherd.video.layout import make_layout, make_phone_layout
from skyherd.video.legend import ITEMS, legend_items

SIZE_PX = (64, 48)
COLORS = [(200, 30, 40), (20, 180, 60), (10, 40, 220), (255, 255, 255), (0, 0, 0), *map(unit_rgb, range(7))]

CODEC_TOLERANCE = 5.0
"""Studio range has 219 levels for 256, so that luma and chroma are off by up to half a step of 1.2 each. Blue
has up to 2.1 times chroma's error, and quantising a flat frame adds about one level of luma."""


def solid(color: tuple[int, int, int]) -> np.ndarray:
    return np.full((SIZE_PX[1], SIZE_PX[0], 3), color, dtype=np.uint8)


@cache
def steps_of(name: str, perception: str, count: int) -> tuple[Mission, tuple[Step, ...]]:
    mission = load_mission(name, [f'perception="{perception}"'])
    return mission, tuple(step for step, _ in zip(run_steps(mission), range(count), strict=False))


def write_video(
    path: Path, frames: Iterator[np.ndarray] | list[np.ndarray], rate_hz: Fraction | float = 10
) -> None:
    with VideoSink(path, SIZE_PX, rate_hz) as sink:
        for frame in frames:
            sink.write(frame)


@pytest.mark.smoke
def test_sink_frames_keep_their_colour(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    write_video(path, [solid(color) for color in COLORS for _ in range(2)])
    frames = list(read_frames(path))
    assert len(frames) == count_frames(path) == 2 * len(COLORS)
    for k, frame in enumerate(frames):
        assert frame.shape == (48, 64, 3)
        np.testing.assert_allclose(frame.mean(axis=(0, 1)), COLORS[k // 2], atol=CODEC_TOLERANCE)
    assert [file.name for file in tmp_path.iterdir()] == ["video.mp4"]


@pytest.mark.parametrize(
    ("rate", "exact"), [(Fraction(30000, 1001), "30000/1001"), (12.5, "25/2"), (10, "10")]
)
def test_sink_keeps_fractional_rates(tmp_path: Path, rate: Fraction | float, exact: str) -> None:
    write_video(tmp_path / "video.mp4", [solid((9, 9, 9))] * 12, rate)
    with av.open(str(tmp_path / "video.mp4")) as container:
        stream = container.streams.video[0]
        assert stream.average_rate == Fraction(exact)
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")


def test_sink_writes_index_first(tmp_path: Path) -> None:
    write_video(tmp_path / "video.mp4", [solid(color) for color in COLORS])
    data = (tmp_path / "video.mp4").read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")


def test_sink_leaves_nothing_if_body_raises(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), VideoSink(tmp_path / "video.mp4", SIZE_PX, 10) as sink:
        sink.write(solid((1, 2, 3)))
        assert list(tmp_path.iterdir()) == [sink.part]
        raise KeyboardInterrupt
    assert not list(tmp_path.iterdir())


def test_failed_run_keeps_earlier_video(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    path.write_bytes(b"former")
    with pytest.raises(ValueError, match="no"), VideoSink(path, SIZE_PX, 10):
        raise ValueError("no")
    assert path.read_bytes() == b"former"


def test_sink_rejects_file_with_lost_frames(tmp_path: Path) -> None:
    sink = VideoSink(tmp_path / "video.mp4", SIZE_PX, 10)
    sink.write(solid((1, 2, 3)))
    sink.write(solid((1, 2, 3)))
    sink.frames += 1
    with pytest.raises(OutputError, match="holds 2 frames, but 3 were written"):
        sink.close()
    assert not list(tmp_path.iterdir())


def test_sink_rejects_video_without_frames(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="no frames were written"):
        write_video(tmp_path / "video.mp4", [])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((48, 62, 3), np.uint8),
        np.zeros((64, 48, 3), np.uint8),
        np.zeros((48, 64), np.uint8),
        np.zeros((48, 64, 4), np.uint8),
        np.zeros((48, 64, 3), np.float64),
    ],
    ids=["narrow", "transposed", "grey", "alpha", "float"],
)
def test_sink_rejects_wrong_frames(tmp_path: Path, frame: np.ndarray) -> None:
    with pytest.raises(OutputError, match=r"frame 0 is .*, expected \(48, 64, 3\) uint8"):
        write_video(tmp_path / "video.mp4", [frame])
    assert not list(tmp_path.iterdir())


def test_closed_sink_rejects_frames(tmp_path: Path) -> None:
    with VideoSink(tmp_path / "video.mp4", SIZE_PX, 10) as sink:
        sink.write(solid((1, 2, 3)))
    with pytest.raises(OutputError, match="is closed"):
        sink.write(solid((1, 2, 3)))
    sink.close()
    assert count_frames(sink.path) == 1


@pytest.mark.parametrize(
    ("target", "size_px", "rate_hz", "complaint"),
    [
        ("missing/video.mp4", SIZE_PX, 10, "no folder"),
        (".", SIZE_PX, 10, "is a folder"),
        ("video.mp4", (63, 48), 10, "must be even"),
        ("video.mp4", (64, 0), 10, "must be even"),
        ("video.mp4", SIZE_PX, 0, "must be positive and finite"),
        ("video.mp4", SIZE_PX, float("nan"), "must be positive and finite"),
        ("n" * 300, SIZE_PX, 10, "cannot be written"),
    ],
)
def test_sink_rejects_bad_target_at_once(
    tmp_path: Path, target: str, size_px: tuple[int, int], rate_hz: float, complaint: str
) -> None:
    with pytest.raises(OutputError, match=complaint) as caught:
        VideoSink(tmp_path / target, size_px, rate_hz)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_non_video_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "video.mp4").write_text("hello")
    with pytest.raises(OutputError, match="cannot be read as a video"):
        list(read_frames(tmp_path / "video.mp4"))


def similarity_by_least_squares(template: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Fit u' = a u - b v + s, v' = b u + a v + t of template points to current ones."""
    one, zero = np.ones(template.size), np.zeros(template.size)
    rows_u = np.stack([template.real, -template.imag, one, zero], axis=1)
    rows_v = np.stack([template.imag, template.real, zero, one], axis=1)
    system, right = np.concatenate([rows_u, rows_v]), np.concatenate([current.real, current.imag])
    moved = system @ np.linalg.lstsq(system, right, rcond=None)[0]
    return np.stack(np.split(moved, 2), axis=1)


@pytest.mark.parametrize(
    ("name", "perception"),
    [
        *(("triangle", "rendered"), ("triangle", "ideal"), ("star", "ideal"), ("grid", "ideal")),
        *(pytest.param(name, "rendered", marks=pytest.mark.slow) for name in ("star", "grid")),
    ],
)
def test_goal_arrows_match_best_similarity(name: str, perception: str) -> None:
    mission, steps = steps_of(name, perception, 4)
    for unit, frame in steps[-1].frames.items():
        robots = frame.sight.detections.select(frame.decision.report.controlled_ids)
        template = mission.template.points_of(robots.ids)
        desired = similarity_by_least_squares(template, to_complex(robots.centers_px))
        np.testing.assert_allclose(
            desired_points_px(frame.decision), desired, atol=1e-6, err_msg=f"unit {unit}"
        )


@pytest.mark.parametrize("size_px", [(640, 400), (1000, 620), (333, 257)])
def test_camera_picture_is_area_average(size_px: tuple[int, int]) -> None:
    """In one step or, where faster, halved first; the image is dark on the left, below and in a box."""
    mission, steps = steps_of("triangle", "rendered", 1)
    (width, height), cell = size_px, np.full((160, 200, 3), 255, np.uint8)
    image = np.add.outer(np.linspace(120, 0, height), np.linspace(130, 0, width)).astype(np.uint8)
    image[height // 3 : height // 2, width // 4 : width // 2] = 0
    view = CameraPanel(0, cell, size_px, mission.scenario.selection.radius)
    frame = steps[0].frames[0]
    view._draw_image(replace(frame, sight=replace(frame.sight, image=image)))
    shown = view._picture.shape[1::-1]
    expected = brightened(cv2.resize(image, shown, interpolation=cv2.INTER_AREA))
    assert np.abs(view._picture.astype(int) - expected[..., None]).mean() < 1.0


def test_arrows_end_at_desired_points() -> None:
    mission, steps = steps_of("triangle", "ideal", 4)
    frame, cell = steps[0].frames[0], np.full((640, 640, 3), 255, np.uint8)
    view = CameraPanel(0, cell, (800, 800), mission.scenario.selection.radius)
    view.draw(frame, steps[0].control_sets)
    purple = (np.abs(cell.astype(int) - rgb(TEMPLATE_COLOR)).max(axis=2) < 60).nonzero()
    drawn = np.stack(purple[::-1], axis=1) - (3, 29)
    for tip in view.to_panel(desired_points_px(frame.decision)):
        assert np.linalg.norm(drawn - tip, axis=1).min() < 3.0


@pytest.mark.parametrize(
    ("name", "perception"),
    [
        *(("triangle", "rendered"), ("star", "ideal"), ("grid", "ideal")),
        pytest.param("grid", "rendered", marks=pytest.mark.slow),
    ],
)
def test_composing_is_deterministic_and_changes_with_steps(name: str, perception: str) -> None:
    mission, steps = steps_of(name, perception, 4)
    films = [
        [composer.compose(step).copy() for step in steps]
        for composer in (Composer(mission), Composer(mission))
    ]
    for first, second in zip(*films, strict=True):
        assert first.shape == (1000, 1600, 3)
        assert first.dtype == np.uint8
        np.testing.assert_array_equal(first, second)
    assert (films[0][0] != films[0][-1]).any()


def test_composed_picture_is_read_only() -> None:
    mission, steps = steps_of("triangle", "ideal", 4)
    composer = Composer(mission, (800, 500))
    assert composer.compose(steps[0]) is composer.compose(steps[1])
    with pytest.raises(ValueError, match="read-only"):
        composer.compose(steps[2])[0, 0] = 0


def test_unit_without_frame_keeps_last_image() -> None:
    mission, steps = steps_of("star", "ideal", 4)
    composer, box = Composer(mission), make_layout((1600, 1000), [(800, 800)] * 3).cameras[1]
    before = box.of(composer.compose(steps[0])).copy()
    late = Step(
        **{**vars(steps[3]), "frames": {0: steps[3].frames[0]}, "control_sets": steps[0].control_sets}
    )
    np.testing.assert_array_equal(box.of(composer.compose(late)), before)


@pytest.mark.parametrize("units", range(1, 17))
@pytest.mark.parametrize("image_px", [(800, 800), (1280, 720), (600, 1000)])
def test_layout_has_no_overlap(units: int, image_px: tuple[int, int]) -> None:
    layout = make_layout((1600, 1000), [image_px] * units)
    covered = np.zeros((1000, 1600), dtype=int)
    boxes = [layout.header, layout.caption, *layout.cameras, layout.key, layout.ground, *layout.plots]
    for box in boxes:
        assert box.left >= 0 and box.top >= 0
        assert box.left + box.width <= 1600 and box.top + box.height <= 1000
        covered[box.top : box.top + box.height, box.left : box.left + box.width] += 1
    assert covered.max() == 1
    assert layout.ground.width >= 400
    assert min(box.width for box in layout.cameras) >= 64


@pytest.mark.parametrize("units", [1, 2, 3, 4, 7, 12, 40])
@pytest.mark.parametrize("rectified", [False, True])
@pytest.mark.parametrize("phone", [False, True])
def test_pairs_and_phone_parts_do_not_overlap(units: int, rectified: bool, phone: bool) -> None:
    sizes = [(800, 600)] * units
    layout = (
        make_phone_layout(sizes, rectified=rectified)
        if phone
        else make_layout((1600, 1000), sizes, rectified=rectified)
    )
    width, height = layout.size_px
    covered = np.zeros((height, width), dtype=int)
    panels = [*layout.cameras, *layout.rectified, layout.key, layout.ground, *layout.plots]
    for box in (layout.header, layout.caption, *panels):
        assert box.left >= 0 and box.top >= 0
        assert box.left + box.width <= width and box.top + box.height <= height
        box.of(covered)[:] += 1
    assert covered.max() == 1
    assert len(layout.cameras) == units
    assert len(layout.rectified) == (units if rectified and units <= 7 else 0) or units == 12
    assert height % 2 == 0


@pytest.mark.parametrize(
    ("name", "absent", "present"),
    [
        ("triangle", "shared with another unit", "desired shape"),
        ("star", "obstacle", "shared with another unit"),
        ("tree", "dead unit", "edge: shared pair and turn"),
        ("failure", "obstacle", "dead unit"),
        ("obstacles", "dead unit", "obstacle"),
        ("crowd", "obstacle", "place just exchanged"),
    ],
)
def test_legend_has_what_can_occur(name: str, absent: str, present: str) -> None:
    texts = [text for _, text in legend_items(load_mission(name))]
    assert present in texts and absent not in texts
    assert len(texts) == len(set(texts))


@pytest.mark.parametrize("phone", [False, True])
def test_last_picture_has_the_verdict_and_the_shape(phone: bool) -> None:
    """Only the caption changes, and a long verdict stays inside of it."""
    mission, steps = steps_of("triangle", "ideal", 4)
    composer = Composer(mission, phone=phone)
    before = composer.compose(steps[-1]).copy()
    box = (make_phone_layout if phone else partial(make_layout, (1600, 1000)))([(800, 800)], ITEMS).caption
    after = composer.conclude("The robots did not form the shape, since " + 30 * "reason ", is_good=False)
    rows, columns = (before != after).any(axis=2).nonzero()
    assert rows.size > 300
    assert box.top <= rows.min() and rows.max() < box.top + box.height
    assert box.left <= columns.min() and columns.max() < box.left + box.width


def test_header_names_speed_of_a_fast_video() -> None:
    """The same step at the speed of the run lacks the words, so that the headers differ."""
    mission, steps = steps_of("triangle", "ideal", 1)
    slow = load_mission("triangle", ["perception=ideal", "video.speed=1"])
    headers = [Composer(m).compose(steps[0])[:40, 150:420].copy() for m in (mission, slow)]
    inked = [int((header < 200).all(axis=2).sum()) for header in headers]
    assert inked[0] > inked[1] + 100


def test_wrapped_text_keeps_number_and_sign_together() -> None:
    lines = wrap_text("an error of 12 % of it", text_width("an error of 12", 13) + 1, 13)
    assert lines == ["an error of", "12\N{NO-BREAK SPACE}% of it"]


@pytest.mark.parametrize(("low", "high"), [(0.0, 100.0), (-3.7, 9.1), (0.71, 1.07), (2e-5, 9e-5)])
def test_ticks_are_round_and_inside(low: float, high: float) -> None:
    ticks = tick_values(low, high, 5)
    assert 3 <= ticks.size <= 9
    assert ticks[0] >= low - 1e-9 and ticks[-1] <= high + 1e-9
    mantissa = np.diff(ticks)[0] / 10.0 ** np.floor(np.log10(np.diff(ticks)[0]) + 1e-9)
    assert np.isclose(mantissa, [1, 2, 5]).any()


def test_ranges_widen_only_if_needed() -> None:
    log = LogRange.around(np.array([300.0, np.nan]))
    assert (log.low, log.high) == (-1, 3)
    assert log.widened(np.array([0.2, np.nan, 0.0])) is log
    assert log.widened(np.array([1e-30])) == LogRange(3 - log.most, 3)
    linear = LinearRange.around(np.array([1.0, 2.0]))
    assert linear.widened(np.array([1.5, np.nan])) is linear
    wider = linear.widened(np.array([5.0]))
    assert wider.low <= linear.low and wider.high >= 5.0
