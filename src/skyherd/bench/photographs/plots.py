"""Figure of the result on photographs: recall."""

import numpy as np
from matplotlib.figure import Figure

from skyherd.bench.detector_style import style_of
from skyherd.bench.photographs.result import PhotographsResult
from skyherd.plots.panels import Panel
from skyherd.plots.style import legend_above, new_figure, plain


def draw_recall(result: PhotographsResult) -> Figure:
    """Draw recall in each set as bars, one for each detector that can read it."""
    figure = new_figure(4.2, 11.0)
    axes = figure.subplots()
    names, sets = result.detectors, [name for name in result.sets if name not in result.unread()]
    width = 0.85 / max(len(names), 1)
    for index, name in enumerate(names):
        rows = [result.row(set_name, name) for set_name in sets]
        heights = [np.nan if row is None or row["recall"] is None else row["recall"] for row in rows]
        places = np.arange(len(sets)) + width * (index - (len(names) - 1) / 2)
        axes.bar(places, heights, width, label=plain(name), color=style_of(names, name)["color"])
    axes.set_xticks(range(len(sets)), [plain(name) for name in sets])
    axes.set(ylim=(0, 1.02), ylabel="recall")
    axes.grid(visible=False, axis="x")
    legend_above(figure, columns=5)
    return figure


PANELS = (
    Panel("recall", "Recall", "Share of the markers that two independent detectors confirm.", draw_recall),
)
"""Figures of the page, in the order shown."""
