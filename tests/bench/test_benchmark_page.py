"""Tables of docs/benchmark.md: a selection of the benchmark's tables, with one figure per cell."""

from types import ModuleType

import pytest

from skyherd.bench.table import Table

SIDES = ("detector", "10 px", "12 px")


@pytest.fixture(scope="module")
def doc(load_benchmark) -> ModuleType:
    """Return the script that writes the page."""
    return load_benchmark("benchmark_doc")


def test_pair_of_errors_becomes_two_tables(doc: ModuleType) -> None:
    rows = (("photometric", "1.11 / 1.13", "1.09 / –"), ("opencv-subpix", "9.0 / 8.0", "7.0 / 6.0"))
    table = Table("Error over the Cramér–Rao bound, noise 5", "", SIDES, rows)
    position, heading = doc.page_tables([table])
    assert position.title == "Position error over the Cramér–Rao bound, noise 5"
    assert position.header == ("detector", "10 px")  # 12 px has no column on the page
    assert position.rows == (("photometric", "1.11"),)
    assert heading.rows == (("photometric", "1.13"),)


def test_other_noises_are_left_out(doc: ModuleType) -> None:
    titles = "Error over the Cramér–Rao bound, noise 2", "Recall, noise 10", "Time per frame, clean"
    assert doc.page_tables([Table(title, "", SIDES, ()) for title in titles]) == []


def test_factor_cell_becomes_position_heading_and_recall(doc: ModuleType) -> None:
    rows = (("none", "1.06 / 1.12, 100.0 %", "–, 0.0 %", "–"),)
    header = ("factor", "photometric", "opencv", "locus-tag")
    (table,) = doc.page_tables([Table("One factor at a time", "", header, rows)])
    assert table.header[1:4] == ("photometric: position", "photometric: heading", "photometric: recall, %")
    assert table.rows == (("none", "1.06", "1.12", "100.0", "–", "0.0"),)


def test_nees_has_a_row_for_each_axis(doc: ModuleType) -> None:
    rows = (("tracking", "1.2 / 1.3 / 1.1", "0.9 / 0.8 / –"),)
    (table,) = doc.page_tables([Table("NEES of the covariance, noise 5", "", SIDES, rows)])
    assert [row[0] for row in table.rows] == ["tracking, u", "tracking, v", "tracking, heading"]
    assert [row[1] for row in table.rows] == ["1.2", "1.3", "1.1"]


def test_page_has_one_figure_in_each_cell(doc: ModuleType) -> None:
    measured = doc.DOC.read_text("utf-8").split(doc.BEGIN)[1].split(doc.END)[0]
    lines = [line for line in measured.splitlines() if line.startswith("| ") and "---" not in line]
    assert len(lines) > 60
    assert not [cell for line in lines for cell in line.strip("| ").split(" | ")[1:] if " / " in cell]
