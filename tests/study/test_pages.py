"""Outputs from a study's table."""

from pathlib import Path
from typing import Any

import pyarrow as pa
from study_runs import SMALL, conduct_here

from skyherd.study.figures import markdown_table, write_figure_pages
from skyherd.study.spec import StudySpec, load_study


def test_markdown_gives_median_and_range_over_seeds() -> None:
    spec = StudySpec.model_validate(
        {
            "scenario": "star",
            "keep": ["shape_error", "converged", "rotation_rad"],
            "grid": {"sensor.noise": [1, 2], "seed": [1, 2, 3]},
        }
    )
    table = pa.table(
        {
            "sensor.noise": [1.0, 1.0, 1.0, 2.0, 2.0],
            "seed": [1, 2, 3, 1, 2],
            "shape_error": [0.1, 0.3, 0.2, 0.5, None],
            "converged": [True, True, False, True, None],
            "rotation_rad": [1.0, 1.0, 1.0, 1.0, None],
            "error": [None, None, None, None, "broke"],
        }
    )
    assert markdown_table(spec, table).splitlines() == [
        "| `sensor.noise` | runs | failed | Shape error | Converged | Rotation (rad) |",
        "| --- | --- | --- | --- | --- | --- |",
        "| 1 | 3 | 0 | 0.2 (0.1 to 0.3) | 2 of 3 | 1 |",
        "| 2 | 2 | 1 | 0.5 | 1 of 1 | 1 |",
    ]


FIGURES = """
[[figures]]
name = "gain"
x = "units.0.yaw_deg"
y = "shape_error"
lines = "control.k"
x_label = "yaw (deg)"
y_log = true
"""


def test_figures_are_drawn_from_available_data(
    write_study: Any, without_cluster: None, tmp_path: Path
) -> None:
    path = write_study(SMALL + FIGURES)
    table, _ = conduct_here(path, tmp_path / "out")
    assert (tmp_path / "out" / "gain.png").read_bytes().startswith(b"\x89PNG")
    none = table.set_column(table.column_names.index("error"), "error", pa.array(["broke"] * 6))
    (tmp_path / "none").mkdir()
    assert [file.name for file in write_figure_pages(load_study(str(path)), none, tmp_path / "none")] == [
        "table.md"
    ]
