"""Figures: all panels exist, match the history, and are reproducible."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from PIL import Image

from skyherd.analysis.history import History, ImageTrace, make_history
from skyherd.datasets import load_mission
from skyherd.drawing.palette import TEMPLATE_COLOR, unit_color
from skyherd.errors import OutputError
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.plots import curves, maps, panels
from skyherd.plots.panels import PANELS, FigureFile, Panel, write_figures
from skyherd.plots.style import DPI, drawing_style, use_log_scale
from skyherd.plots.topology import BAR, draw_topology, runs


def short_run(name: str, duration_s: float, *settings: str) -> History:
    mission = load_mission(name, [f"duration_s={duration_s}", "perception='ideal'", *settings])
    return make_history(mission, run_steps(mission))


@pytest.fixture(scope="module", autouse=True)
def fine_figures() -> Iterator[None]:
    """Set the resolution of users' figures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(panels, "DPI", DPI)
        yield


@pytest.fixture(scope="module")
def history() -> History:
    return short_run("star", 2.0)


@pytest.fixture(scope="module")
def one_step_one_unit() -> History:
    history = short_run("triangle", 0.04)
    assert history.times_s.size == 1
    return history


@pytest.fixture(scope="module", params=["one_step_one_unit", pytest.param("history", marks=pytest.mark.slow)])
def shown(request: pytest.FixtureRequest) -> History:
    """Return one step of one unit, or two seconds of three."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="module")
def figures(shown: History, tmp_path_factory: pytest.TempPathFactory) -> list[FigureFile]:
    return write_figures(shown, tmp_path_factory.mktemp("run") / "new" / "folder")


@pytest.fixture(scope="module")
def draw() -> Callable[[Callable[[History], Figure], History], Figure]:
    """Draw a figure in the style of the files, and lay it out."""

    def draw_it(panel: Callable[[History], Figure], history: History) -> Figure:
        with drawing_style():
            figure = panel(history)
            figure.draw_without_rendering()
            return figure

    return draw_it


def each_column(values: np.ndarray) -> list[np.ndarray]:
    return list(np.asarray(values).T)


def drawn(axes: Any, label_start: str) -> list[np.ndarray]:
    """Return the vertical data of lines whose label starts with the text."""
    return [np.asarray(line.get_ydata()) for line in axes.lines if line.get_label().startswith(label_start)]


def test_every_panel_has_png_and_svg(figures: list[FigureFile]) -> None:
    assert [figure.name for figure in figures] == [panel.name for panel in PANELS]
    for figure in figures:
        with Image.open(figure.png) as image:
            image.load()
            assert min(image.size) > 300
        assert b"</svg>" in figure.svg.read_bytes()[-20:]
        assert figure.title and figure.caption.endswith(".")
    left = {path.name for path in figures[0].png.parent.iterdir()}
    assert left == {f"{panel.name}.{kind}" for panel in PANELS for kind in ("png", "svg")}


def test_figures_ignore_user_settings_of_matplotlib(
    shown: History,
    figures: list[FigureFile],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every fourth of one step, all of several, are redrawn under conspicuous settings."""
    every = 4 if shown.times_s.size == 1 else 1
    monkeypatch.setattr(panels, "PANELS", PANELS[::every])
    with mpl.rc_context({"font.size": 20, "axes.facecolor": "black", "svg.hashsalt": None}):
        again = write_figures(shown, tmp_path)
        assert mpl.rcParams["font.size"] == 20
    for one, other in zip(figures[::every], again, strict=True):
        assert one.png.read_bytes() == other.png.read_bytes()
        assert one.svg.read_bytes() == other.svg.read_bytes()


def test_single_value_is_drawn_as_dot(one_step_one_unit: History, draw: Any) -> None:
    figure = draw(curves.draw_shape_error, one_step_one_unit)
    (line,) = [line for line in figure.axes[0].lines if line.get_label() == "shape error"]
    assert line.get_marker() == "o"


COLUMNS = ("V", "V_units", "scales", "rotations_rad", "shape_error", "v_mps")


LOGARITHMIC = {"cost", "shape_error"}


@pytest.mark.parametrize(
    ("panel", "value"),
    [
        *(pytest.param(panel, np.nan, id=f"{panel.name}-nan") for panel in PANELS),
        *(
            pytest.param(
                panel,
                0.0,
                id=f"{panel.name}-zero",
                marks=() if panel.name in LOGARITHMIC else pytest.mark.slow,
            )
            for panel in PANELS
        ),
    ],
)
def test_empty_panel_is_no_error(panel: Panel, value: float, history: History, draw: Any) -> None:
    empty = {name: np.full_like(getattr(history, name), value) for name in COLUMNS}
    unseen = [ImageTrace(trace.times_s, np.full_like(trace.points_px, np.nan)) for trace in history.traces]
    draw(panel.draw, replace(history, **empty, traces=unseen))


def test_unit_without_images_is_drawn(history: History, draw: Any) -> None:
    blind = ImageTrace(np.zeros(0), np.zeros((0, history.ids.size), dtype=complex))
    draw(maps.draw_image_traces, replace(history, traces=[blind, *history.traces[1:]]))


def test_cost_matches_history(history: History, draw: Any) -> None:
    figure = draw(curves.draw_cost, history)
    for axes in figure.axes:
        np.testing.assert_array_equal(drawn(axes, "V"), [history.V])
        np.testing.assert_array_equal(drawn(axes, "unit"), each_column(history.V_units))
    assert [axes.get_yscale() for axes in figure.axes] == ["linear", "log"]


@pytest.mark.parametrize(
    ("panel", "column", "factor"),
    [
        (curves.draw_scales, "scales", 1.0),
        (curves.draw_rotations, "rotations_rad", 180 / np.pi),
        (curves.draw_heights, "heights_m", 1.0),
        (curves.draw_yaws, "yaws_rad", 180 / np.pi),
    ],
)
def test_unit_lines_match_history(
    panel: Callable[[History], Figure], column: str, factor: float, history: History, draw: Any
) -> None:
    figure = draw(panel, history)
    expected = [line * factor for line in each_column(getattr(history, column))]
    np.testing.assert_allclose(drawn(figure.axes[0], "unit"), expected, rtol=1e-9)


def test_robot_velocities_match_history(history: History, draw: Any) -> None:
    figure = draw(curves.draw_robot_velocities, history)
    for axes, values in zip(figure.axes[:2], (history.v_mps, history.omega_radps), strict=True):
        np.testing.assert_array_equal([line.get_ydata() for line in axes.lines[1:]], each_column(values))


def test_paths_and_traces_match_history(history: History, draw: Any) -> None:
    on_ground = draw(maps.draw_paths, history).axes[0].lines
    for robot, line in enumerate(on_ground[: history.ids.size]):
        np.testing.assert_array_equal(line.get_xydata(), history.positions_m[:, robot])
    in_images = draw(maps.draw_image_traces, history).axes
    for unit, (axes, trace) in enumerate(zip(in_images, history.traces, strict=True)):
        lines = axes.lines[: history.ids.size]
        points = np.array([to_complex(line.get_xydata()) for line in lines]).T
        np.testing.assert_allclose(points[-1], trace.points_px[-1], atol=1e-9)
        assert not np.isfinite(points[~history.controlled[:, unit]]).any()
        assert axes.yaxis_inverted()


def test_camera_speeds_are_finite_differences(history: History) -> None:
    step_s = history.mission.scenario.step_s
    climb_mps = np.diff(history.heights_m, axis=0) / step_s
    along_mps = np.diff(history.unit_positions_m, axis=0) / step_s
    expected = np.sqrt(climb_mps**2 + (along_mps**2).sum(axis=2))
    np.testing.assert_allclose(curves.camera_speeds_mps(history), expected, rtol=1e-6)


def test_zoom_panel_appears_only_if_zoom_changes(draw: Any) -> None:
    zooming = short_run("triangle", 1.0, "units.0.zoom=[[0, 1], [1, 2]]")
    axes = draw(curves.draw_heights, zooming).axes
    assert len(axes) == 2
    np.testing.assert_array_equal(drawn(axes[1], "unit"), each_column(zooming.zooms))


def test_template_axis_points_down(history: History, draw: Any) -> None:
    axes = draw(maps.draw_template, history).axes[0]
    assert axes.yaxis_inverted()
    (dots,) = [line for line in axes.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(to_complex(dots.get_xydata()), history.mission.template.points_px)


def test_topology_bars_cover_controlled_times(history: History, draw: Any) -> None:
    axes = draw(draw_topology, history).axes[0]
    areas = {
        to_hex(bars.get_facecolor()[0]): sum(
            np.ptp(path.vertices, axis=0).prod() for path in bars.get_paths()
        )
        for bars in axes.collections
    }
    shares = history.controlled / np.maximum(history.controlled.sum(axis=1, keepdims=True), 1)
    expected = shares.sum(axis=(0, 2)) * history.mission.scenario.step_s * BAR
    assert areas == {unit_color(unit).lower(): pytest.approx(area) for unit, area in enumerate(expected)}


def test_runs_are_stretches_of_equal_rows() -> None:
    states = np.array([[1, 0], [1, 0], [1, 1], [0, 1], [0, 1]], dtype=bool)
    assert list(runs(states)) == [(0, 2), (2, 3), (3, 5)]
    assert list(runs(states[:1])) == [(0, 1)]


def test_unwrap_skips_unknown_angles() -> None:
    angles_rad = np.array([3.0, np.nan, -3.0, -2.9])
    np.testing.assert_allclose(curves.unwrap(angles_rad), [3.0, np.nan, 2 * np.pi - 3.0, 2 * np.pi - 2.9])


def test_letters_have_strokes_of_their_own(draw: Any) -> None:
    """A line between two letters would be longer than the widest stroke, of one letter height."""
    words = short_run("letters", 0.2)
    strokes = len(words.mission.outline_at(0.0))
    for panel, scale in ((maps.draw_template, 1.0), (maps.draw_paths, words.shape_scale[-1])):
        lines = [line for line in draw(panel, words).axes[0].lines if line.get_color() == TEMPLATE_COLOR]
        drawn = [to_complex(line.get_xydata()) for line in lines if line.get_marker() != "o"]
        assert len(drawn) == strokes
        assert max(np.abs(np.diff(line)).max() for line in drawn) < 1.01 * scale


def test_still_robot_has_no_trace_under_a_moving_camera(history: History) -> None:
    """The camera turns and climbs; the trace of a robot at rest is one point."""
    still = np.broadcast_to(history.positions_m[-1], history.positions_m.shape)
    assert np.ptp(history.heights_m[:, 0]) > 0.01
    points = maps.still_traces(replace(history, positions_m=still), 0)
    spread = np.nanmax(np.abs(points - points[-1]), axis=0, initial=0.0)
    assert np.isfinite(points[-1]).any() and np.nanmax(spread) < 1e-9


@pytest.mark.parametrize(("low", "high"), [(0.3, 0.8), (1.5, 8.0), (0.15, 2.5), (1e-5, 300.0)])
def test_log_axis_has_two_labelled_ticks_or_more(low: float, high: float, draw: Any) -> None:
    def panel(_: History) -> Figure:
        figure = Figure()
        axes = figure.subplots()
        axes.plot([0, 1], [low, high])
        use_log_scale(axes)
        return figure

    figure = draw(panel, None)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    bottom, top = axes.get_ylim()
    texts = zip(axes.yaxis.get_majorticklocs(), axes.yaxis.get_majorticklabels(), strict=True)
    shown = [text.get_text() for at, text in texts if bottom <= at <= top and text.get_text()]
    assert 2 <= len(shown) <= 8


def test_unwritable_file_is_named(history: History, tmp_path: Path) -> None:
    (tmp_path / "paths.png").mkdir()
    with pytest.raises(OutputError, match=r"paths\.png: cannot be written"):
        write_figures(history, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["paths.png"]
