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
from skyherd.datasets import load_mission, shape_points
from skyherd.drawing.palette import unit_color
from skyherd.errors import OutputError
from skyherd.geometry import to_complex
from skyherd.loop import run_steps
from skyherd.plots import curves, maps, panels
from skyherd.plots.panels import PANELS, FigureFile, Panel, write_figures
from skyherd.plots.style import DPI, drawing_style
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
    for axes, trace in zip(in_images, history.traces, strict=True):
        lines = axes.lines[: history.ids.size]
        points = np.array([to_complex(line.get_xydata()) for line in lines])
        np.testing.assert_array_equal(points.T, trace.points_px)
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


@pytest.mark.parametrize("count", [6, 16, 30])
def test_star_outline_joins_tip_to_notch(count: int) -> None:
    points = to_complex(np.random.default_rng(count).permutation(shape_points("star", count)))
    radii = np.abs(points[maps.formation_order(points)])
    assert ((radii > 0.9) != (np.roll(radii, 1) > 0.9)).all()


@pytest.mark.smoke
@pytest.mark.parametrize("count", [1, 2, 3, 4, 11])
def test_outline_visits_each_point_and_never_crosses(count: int) -> None:
    points = to_complex(np.random.default_rng(count).normal(size=(count, 2)))
    order = maps.formation_order(points)
    assert sorted(order) == list(range(count))
    ends = list(zip(points[order], points[np.roll(order, -1)], strict=True))

    def apart(a: complex, b: complex, c: complex, d: complex) -> bool:
        """Return whether c and d lie on one side of the line from a to b, or touch it."""
        return bool(((b - a).conjugate() * (c - a)).imag * ((b - a).conjugate() * (d - a)).imag > -1e-9)

    for index, (a, b) in enumerate(ends):
        for c, d in ends[:index]:
            assert apart(a, b, c, d) or apart(c, d, a, b)


def test_unwritable_file_is_named(history: History, tmp_path: Path) -> None:
    (tmp_path / "paths.png").mkdir()
    with pytest.raises(OutputError, match=r"paths\.png: cannot be written"):
        write_figures(history, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["paths.png"]
