"""Text tables for the terminal, the page and Markdown, and number formats."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

NONE = "–"
"""Text of a cell without a measurement."""


@dataclass(frozen=True)
class Table:
    """A table of texts.

    Attributes:
        title: heading.
        note: an explanatory sentence below it.
        header: names of the columns.
        rows: cells, as many as the header has; the first of each names the row.
    """

    title: str
    note: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def markdown(self) -> str:
        """Return the table in Markdown, under its title as a heading of the third level."""
        lines = [self.header, ("---",) * len(self.header), *self.rows]
        return f"### {self.title}\n\n{self.note}\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in lines)


def short(value: float | None) -> str:
    """Format a number with about three digits: two decimals below 10, one below 100; `–` for None."""
    if value is None:
        return NONE
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def share(value: float | None) -> str:
    """Format a share in per cent; 0.0 and 100.0 only if exactly none or all; `–` for None."""
    if value is None:
        return NONE
    return f"{100 * value:.1f} %" if value in (0.0, 1.0) else f"{min(max(100 * value, 0.1), 99.9):.1f} %"


def markdown_page(tables: Sequence[Table], environment: Mapping[str, object]) -> str:
    """Return tables in Markdown, followed by programs and machine of the measurement."""
    about = ", ".join(f"{key} {value}" for key, value in environment.items() if value is not None)
    return "\n\n".join([*(table.markdown() for table in tables), f"Measured with: {about}."]) + "\n"


def plain_text(value: object) -> str:
    """Return an entry of the environment as text; None stands for a missing program."""
    return "not installed" if value is None else ", ".join(value) if isinstance(value, list) else str(value)
