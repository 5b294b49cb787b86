"""What is made of a study's table: for each kind of pages, a function from study and table to files."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pyarrow as pa

from skyherd.study.figures import write_figure_pages
from skyherd.study.invariance_page import write_invariance
from skyherd.study.methods_page import write_methods
from skyherd.study.spec import Study

Pages = Callable[[Study, pa.Table, Path], list[Path]]
"""Writes files into a folder, and says which; the first is the one to open."""

PAGES: Mapping[str, Pages] = {
    "figures": write_figure_pages,
    "invariance": write_invariance,
    "methods": write_methods,
}
"""By the name that a study's `pages` has."""


def write_pages(study: Study, table: pa.Table, folder: Path) -> list[Path]:
    """Write the pages that a study asks for.

    Raises:
        OutputError: a file could not be written.
    """
    return PAGES[study.spec.pages](study, table, folder)
