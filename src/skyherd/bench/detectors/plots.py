"""Figures of the benchmark's result, PNG and SVG."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

from skyherd.bench.detector_style import style_of
from skyherd.bench.detectors.axes import AIM, ratio_axes, share_axes, side_axis, span
from skyherd.bench.detectors.design import CAMERA_SWEEPS, SWEEPS, Sweep
from skyherd.bench.detectors.tables import MIDDLE_NOISE
from skyherd.bench.result import Result, Row
from skyherd.drawing.palette import INK, MUTED
from skyherd.plots.panels import FigureFile, Panel, write_panels
from skyherd.plots.style import legend_above, new_figure

NEES_BAND = (0.8, 1.25)
"""NEES band of consistent variances: off by at most a quarter."""


def write_plots(result: Result, folder: Path) -> list[FigureFile]:
    """Draw all figures with data into a folder, as `skyherd.plots.panels.write_panels`."""
    return write_panels(PLOTS, result, folder)


def detector_style(result: Result, name: str) -> dict[str, Any]:
    """Return the style of a detector's line, the same in all figures of a result."""
    return style_of(result.detectors, name)


def _legend(figure: Figure, result: Result, names: Iterable[str]) -> None:
    handles = [Line2D([], [], label=name, **detector_style(result, name)) for name in names]
    legend_above(figure, handles, columns=4)


def _line(axes: Axes, points: list[tuple[float, float | None]], style: dict[str, Any]) -> None:
    known = np.array([(x, np.nan if y is None else y) for x, y in points], dtype=float).reshape(-1, 2)
    axes.plot(known[:, 0], known[:, 1], **style)


def _grid_figure(
    result: Result, keys: tuple[tuple[str, str], ...], height_in: float
) -> tuple[Figure, Any] | None:
    """Create a panel for each key and noise level, with a line over the side for each detector."""
    noises = result.noises()
    if not noises:
        return None
    figure = new_figure(height_in, 3.2 * len(noises) + 1.0 if len(noises) > 1 else 7.2)
    panels = figure.subplots(len(keys), len(noises), sharex=True, sharey="row", squeeze=False)
    for (key, label), row in zip(keys, panels, strict=True):
        for noise, axes in zip(noises, row, strict=True):
            for name in result.detectors:
                points = [(r["side_px"], r[key]) for r in result.by_side(name, noise)]
                _line(axes, points, detector_style(result, name))
        row[0].set_ylabel(label)
    for noise, top, bottom in zip(noises, panels[0], panels[-1], strict=True):
        top.set_title(f"noise {noise:g} grey levels")
        bottom.set_xlabel("marker side (px)")
        side_axis(
            bottom, (r["side_px"] for r in result.cells if r["noise"] == noise and r["sweep"] != "base")
        )
    _legend(figure, result, result.detectors)
    return figure, panels


def draw_accuracy(result: Result) -> Figure | None:
    """Draw RMSE over bound by marker side, a column for each noise: position above, heading below."""
    made = _grid_figure(
        result, (("ratio_px", "position: RMSE / bound"), ("ratio_deg", "heading: RMSE / bound")), 6.6
    )
    if made is None:
        return None
    figure, panels = made
    for row in panels:
        ratio_axes(row)
    return figure


def draw_recall(result: Result) -> Figure | None:
    """Draw recall by marker side, a column for each noise."""
    made = _grid_figure(result, (("recall", "recall"),), 3.9)
    if made is None:
        return None
    figure, panels = made
    share_axes(panels.ravel())
    return figure


def _sweep_figure(
    result: Result,
    sweeps: Sequence[Sweep],
    key: str,
    label: str,
    finish: Callable[[Sequence[Axes]], None],
) -> Figure | None:
    shown = [s for s in sweeps if any(row["sweep"] == s.name for row in result.cells)]
    if not shown:
        return None
    columns = 4
    rows = -(-len(shown) // columns)
    figure = new_figure(2.9 * rows + 0.8, 11.0)
    panels = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axes in panels.ravel()[len(shown) :]:
        axes.set_visible(False)
    for sweep, axes in zip(shown, panels.ravel(), strict=False):
        for name in result.detectors:
            points = [(value, row[key]) for value, row in result.along(sweep, name)]
            _line(axes, points, detector_style(result, name))
        axes.set_xlabel(sweep.label)
    finish(list(panels.ravel()[: len(shown)]))
    for row in panels:
        row[0].set_ylabel(label)
    _legend(figure, result, result.detectors)
    return figure


def draw_factors(result: Result) -> Figure | None:
    """Draw the position's RMSE over its bound along each sweep over scene and sensor."""
    return _sweep_figure(result, SWEEPS, "ratio_px", "position: RMSE / bound", ratio_axes)


def draw_factor_recall(result: Result) -> Figure | None:
    """Draw recall along each sweep over scene and sensor."""
    return _sweep_figure(result, SWEEPS, "recall", "recall", share_axes)


def draw_camera(result: Result) -> Figure | None:
    """Draw the position's RMSE over its bound along each sweep over lens and processing."""
    return _sweep_figure(result, CAMERA_SWEEPS, "ratio_px", "position: RMSE / bound", ratio_axes)


def draw_camera_recall(result: Result) -> Figure | None:
    """Draw recall along each sweep over lens and processing."""
    return _sweep_figure(result, CAMERA_SWEEPS, "recall", "recall", share_axes)


def draw_nees(result: Result) -> Figure | None:
    """Draw NEES of u, v and heading by marker side, of detectors that report a covariance."""
    noises = result.noises()
    reporting = [
        name
        for name in result.detectors
        if any(row["nees"] is not None for noise in noises for row in result.by_side(name, noise))
    ]
    if not reporting:
        return None
    figure = new_figure(3.7, 10.0)
    panels = figure.subplots(1, 3, sharey=True)
    noise = min(noises, key=lambda level: abs(level - MIDDLE_NOISE))
    for axis, axes in zip(("u", "v", "heading"), panels, strict=True):
        for name in reporting:
            rows: list[Row] = result.by_side(name, noise)
            _line(axes, [(row["side_px"], row[f"nees_{axis}"]) for row in rows], detector_style(result, name))
        axes.axhspan(*NEES_BAND, color=MUTED, alpha=0.18, lw=0)
        axes.axhline(1.0, color=INK, lw=1.0)
        axes.set(title=axis, xlabel="marker side (px)", yscale="log")
        side_axis(axes, (row["side_px"] for name in reporting for row in result.by_side(name, noise)))
        axes.yaxis.set_major_locator(FixedLocator([0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 1000]))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panels[0].set_ylim(span(panels, 0.5, 2.0))
    panels[0].set_ylabel("error² / variance reported")
    _legend(figure, result, reporting)
    return figure


def draw_times(result: Result) -> Figure | None:
    """Draw the median time per frame, ms, by image size, with a whisker to the 99th percentile."""
    noises = sorted({row["noise"] for row in result.timing})
    if not noises:
        return None
    figure = new_figure(4.4, 4.6 * len(noises) + 0.6)
    panels = figure.subplots(1, len(noises), sharey=True, squeeze=False)[0]
    sizes = sorted({(row["width_px"], row["height_px"]) for row in result.timing})
    for noise, axes in zip(noises, panels, strict=True):
        for index, name in enumerate(result.detectors):
            rows = {
                (r["width_px"], r["height_px"]): r
                for r in result.timing
                if (r["noise"], r["detector"]) == (noise, name)
            }
            at = [k for k, size in enumerate(sizes) if size in rows]
            if not at:
                continue
            median = np.array([rows[sizes[k]]["ms_median"] for k in at])
            above = np.array([rows[sizes[k]]["ms_p99"] for k in at]) - median
            x = np.array(at) + 0.045 * (index - (len(result.detectors) - 1) / 2)
            above = np.stack([np.zeros_like(above), np.maximum(above, 0)])
            axes.errorbar(x, median, yerr=above, elinewidth=0.9, **detector_style(result, name))
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xticks(range(len(sizes)), [f"{width}x{height}" for width, height in sizes])
        title = "clean" if noise == 0 else f"noise {noise:g} grey levels"
        axes.set(title=title, xlabel="image (px)")
    panels[0].set_ylabel("time per frame (ms)")
    _legend(figure, result, result.detectors)
    return figure


PLOTS: tuple[Panel[Result], ...] = (
    Panel(
        "accuracy",
        "Accuracy",
        "RMSE of the markers found over the Cramér–Rao bound, by marker side; the line at 1 is the bound, "
        f"the dotted one {AIM:g}. Blur from 0.5 to 1.5 px, which no detector is given.",
        draw_accuracy,
    ),
    Panel(
        "recall",
        "Recall",
        "Share of the whole markers in view that were found, in the same images.",
        draw_recall,
    ),
    Panel(
        "factors",
        "One factor at a time",
        "RMSE of the position over its bound as one factor leaves the base cell: 30 px, noise 5, full "
        "contrast, seen from straight above.",
        draw_factors,
    ),
    Panel("factor_recall", "Recall, one factor at a time", "Recall in the same cells.", draw_factor_recall),
    Panel(
        "camera",
        "Lens and processing, one at a time",
        "The same through what a consumer camera does: non-Gaussian blur, colour filters, tone, "
        "denoising, sharpening, codecs, and all of it. The bound is that of the raw pixels.",
        draw_camera,
    ),
    Panel(
        "camera_recall",
        "Recall, lens and processing",
        "Recall in the same cells.",
        draw_camera_recall,
    ),
    Panel(
        "honesty",
        "Covariance compared with the errors",
        "Mean of error² over the variance that the detector reports; 1 is right, the band is 0.8 to 1.25, "
        "more means variances that are too small. Detectors that report none are left out.",
        draw_nees,
    ),
    Panel(
        "times",
        "Time per frame",
        "Median, with a whisker to the 99th percentile; one thread, sixteen markers of 30 px that move, all "
        "detectors on the same frames in turn.",
        draw_times,
    ),
)
"""Figures of the benchmark's page, in the order shown."""
