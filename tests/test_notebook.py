"""Notebook of the examples, run cell by cell without Jupyter."""

import json
from pathlib import Path

import matplotlib
import numpy as np
import pytest

NOTEBOOK = Path(__file__).parent.parent / "examples/from_image_to_plot.ipynb"


def code_cells(path: Path) -> list[dict]:
    return [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


def run(cells: list[dict]) -> dict:
    """Return the names after all cells have run in order; an error names its cell."""
    names: dict = {}
    for number, cell in enumerate(cells):
        exec(compile("".join(cell["source"]), f"cell {number}", "exec"), names)
    return names


@pytest.fixture(scope="module")
def names():
    before = matplotlib.get_backend()
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    yield run(code_cells(NOTEBOOK))
    plt.close("all")
    matplotlib.use(before)


class TestNotebook:
    def test_is_committed_without_outputs(self) -> None:
        for cell in code_cells(NOTEBOOK):
            assert cell["outputs"] == [] and cell["execution_count"] is None

    def test_detections_have_honest_covariances(self, names) -> None:
        nees, found = names["nees"], names["found"]
        assert len(found) == found.covariances.shape[0] >= 10
        # The mean of N chi-squared numbers of 3 degrees of freedom has variance 6 / N: five sigmas.
        assert abs(nees.mean() - 3) < 5 * np.sqrt(6 / nees.size)
        # Negative control: standard deviations a tenth as large fail.
        assert abs(100 * nees.mean() - 3) > 5 * np.sqrt(6 / nees.size)

    def test_scenario_reaches_its_shape_while_v_falls(self, names) -> None:
        assert names["errors"][0] > 0.1 and names["errors"][-1] < 0.01
        assert (np.diff(names["costs_m2"]) <= 1e-9).all()  # rounding of sums of squares in metres

    def test_both_figures_are_drawn(self, names) -> None:
        assert len(names["axes"].lines) == len(names["found"])
        assert len(names["ground"].lines) == 8 and len(names["cost"].lines) == 2

    def test_cell_with_an_error_is_named(self) -> None:
        with pytest.raises(NameError) as wrong:
            run([{"source": ["a = 1"]}, {"source": ["b = a + c"]}])
        assert "cell 1" in str(wrong.traceback[-1])
