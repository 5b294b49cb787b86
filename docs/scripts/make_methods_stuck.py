"""Make methods_stuck.png: the starts of the task triangle that skyherd did not form, a panel a start.

python docs/scripts/make_methods_stuck.py DIR        # DIR is that of `skyherd study methods --out DIR`
"""

import sys
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from skyherd.plots.style import drawing_style
from skyherd.study.methods.outcomes import make_methods
from skyherd.study.methods.paths import draw_paths
from skyherd.study.spec import load_study
from skyherd.study.table import read_table

FIGURE = Path(__file__).parent.parent / "methods_stuck.png"
TASK, OURS = "triangle", "skyherd"
BODIES = {"radius_m": 0.4, "obstacles": []}
"""What stands on the ground in this task, as `draw_paths` takes it."""


def stuck(table: pa.Table) -> pa.Table:
    """The rows of the runs that are drawn."""
    ours = pc.and_(pc.equal(table["sweep"], OURS), pc.equal(table["task"], TASK))
    return table.filter(pc.and_(ours, pc.invert(table["converged"])))


def main(folder: Path) -> None:
    """Draw them as the study draws the first start of each method, and write the picture."""
    study, rows = load_study("methods"), stuck(read_table(folder))
    panels = []
    for index in range(rows.num_rows):
        run = rows.slice(index, 1)
        ours = next(method for method in make_methods(study, run) if method.name == OURS)
        panels.append(replace(ours, name=f"seed {run['seed'][0].as_py()}"))
    with drawing_style():
        draw_paths(TASK, panels, BODIES).savefig(FIGURE, dpi=130)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
