"""Figures of a run as PNG and SVG: all panels of the paper's two simulation figures, and more."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skyherd.analysis.history import History
from skyherd.errors import OutputError
from skyherd.files.atomic import write_whole
from skyherd.jobs.helpers import shared
from skyherd.plots import curves, maps
from skyherd.plots.graph import draw_graph
from skyherd.plots.style import DPI, drawing_style
from skyherd.plots.topology import draw_topology


@dataclass(frozen=True)
class FigureFile:
    """A figure on disk.

    Attributes:
        name: file name without suffix, and HTML id.
        title: a heading of a few words.
        caption: a sentence or two on the content.
        png: path of the raster picture.
        svg: path of the vector graphics; None if there are none.
    """

    name: str
    title: str
    caption: str
    png: Path
    svg: Path | None = None


Shown = TypeVar("Shown")
"""Data of a panel: a run's history, or a result."""


@dataclass(frozen=True)
class Panel(Generic[Shown]):
    """A figure that can be drawn of any object of a kind, such as any run.

    Attributes:
        name: as in `FigureFile`.
        title: as in `FigureFile`.
        caption: as in `FigureFile`.
        draw: drawing function; returns None if there is nothing to show.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Shown], Figure | None]


PANELS: tuple[Panel[History], ...] = (
    Panel(
        "paths",
        "Paths on the ground",
        "Robots from their start (squares) to their end (numbered circles), with the lines of the shape; "
        "cameras' paths in colour, seen from above, with the ground that each sees at the end.",
        maps.draw_paths,
    ),
    Panel(
        "shape_error",
        "Shape error",
        "RMS distance to the best-fitting copy of the shape, at any position, size and rotation, over the "
        "formation's RMS radius.",
        curves.draw_shape_error,
    ),
    Panel(
        "scales",
        "Scale of the formations",
        "Size of the shape that fits each unit's robots best. All agree once the shape is formed.",
        curves.draw_scales,
    ),
    Panel(
        "cost",
        "Cost function",
        "The Lyapunov function V falls to zero as the shape forms. It is the sum of the units' shares, and "
        "may jump where the topology changes.",
        curves.draw_cost,
    ),
    Panel(
        "robot_velocities",
        "Robot velocities",
        "Forward speed and turn rate (counter-clockwise) of every robot, within its wheels' limits.",
        curves.draw_robot_velocities,
    ),
    Panel(
        "rotations",
        "Rotation of the formations",
        "Orientation, counter-clockwise on the ground, of the shape that fits each unit's robots "
        "best. All agree once the shape is formed.",
        curves.draw_rotations,
    ),
    Panel(
        "heights",
        "Camera heights",
        "Height of every camera above the ground, and varying zoom factors. Units do not know them.",
        curves.draw_heights,
    ),
    Panel(
        "image_traces",
        "Image traces",
        "Paths of the robots that each unit controlled, from the start of its control (squares) to the end "
        "(circles), as its last image shows the ground. Inside the safety radius a unit takes control of a "
        "robot; beyond the leaving radius it may release it.",
        maps.draw_image_traces,
    ),
    Panel(
        "template",
        "Template image",
        "Desired shape, one image point per robot. Its position, size and rotation do not matter.",
        maps.draw_template,
    ),
    Panel(
        "graph",
        "Units and shared robots",
        "The topology at the end, on the ground: thin lines from each unit to the robots that it controls, "
        "thick ones between units that share two or more; shared robots have a ring for each of their units.",
        draw_graph,
    ),
    Panel(
        "yaws",
        "Camera rotation",
        "Yaw of every camera, counter-clockwise seen from above.",
        curves.draw_yaws,
    ),
    Panel(
        "camera_speeds",
        "Camera speeds",
        "Norm of every camera's velocity, horizontal and vertical together.",
        curves.draw_camera_speeds,
    ),
    Panel(
        "topology",
        "Control topology",
        "The units that control each robot, by colour (an empty row: none), and when the paper's "
        "conditions TC1-TC5 hold; of a tree of units, when each belonged to it. TC1 and TC2 suffice for "
        "local convergence; all five for global convergence.",
        draw_topology,
    ),
)
"""Figures of a run's page, in the order shown."""


def write_figures(history: History, folder: Path, *, jobs: int = 1) -> list[FigureFile]:
    """Draw all panels of a run into a folder, as `write_panels` does."""
    return write_panels(PANELS, history, folder, jobs=jobs)


def write_panels(
    panels: Iterable[Panel[Shown]], shown: Shown, folder: Path, *, jobs: int = 1
) -> list[FigureFile]:
    """Draw panels of an object into a folder, created if missing, as PNG and SVG.

    The same input gives the same bytes. Matplotlib's style changes during the call and is restored after it.

    Args:
        panels: panels to draw.
        shown: their data.
        folder: folder of the files.
        jobs: number of panels drawn in parallel by processes, where these can be forked.

    Returns:
        the files, in the order of the panels, without those that have nothing to show.

    Raises:
        OutputError: a file could not be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawn = tuple(panels)

    def write(row: int) -> FigureFile | None:
        panel = drawn[row]
        figure = panel.draw(shown)
        return None if figure is None else save_figure(figure, folder, panel.name, panel.title, panel.caption)

    with drawing_style():
        gone = OutputError(
            f"{folder}: a process that drew figures ended unexpectedly; is there enough memory?"
        )
        files = shared(write, range(len(drawn)), jobs, gone)
    return [file for file in files if file is not None]


def save_figure(figure: Figure, folder: Path, name: str, title: str, caption: str) -> FigureFile:
    """Write a figure as PNG and SVG into an existing folder.

    Both use the layout of the PNG, computed once: it takes longer than drawing.

    Args:
        figure: the figure.
        folder: folder of the files.
        name: file name without suffix.
        title: heading of the figure on pages.
        caption: text below it on pages.

    Raises:
        OutputError: a file could not be written.
    """
    png, svg = folder / f"{name}.png", folder / f"{name}.svg"
    figure.set_dpi(DPI)
    # `savefig` would draw twice, first only for the layout, which is computed when drawing begins.
    write_whole(png, FigureCanvasAgg(figure).print_png)
    figure.set_layout_engine(None)
    write_whole(svg, lambda part: figure.savefig(part, format="svg", metadata={"Date": None}))
    return FigureFile(name=name, title=title, caption=caption, png=png, svg=svg)
