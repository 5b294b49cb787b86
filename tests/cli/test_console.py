"""Output of the command line: which stream, one line, tables, and the progress reporter."""

import warnings

import pytest

from skyherd.cli.console import (
    ProgressReporter,
    complain,
    printing_input_warnings,
    say,
    say_table,
    warn,
)
from skyherd.errors import InputWarning


def test_console_prints_results_to_stdout_and_the_rest_to_stderr(capsys):
    say("[0] of 3")
    complain("a line\n  and another")
    warn("look")
    assert capsys.readouterr() == ("[0] of 3\n", "error: a line and another\nwarning: look\n")


def test_input_warning_is_one_line_printed_once(capsys):
    with printing_input_warnings():
        for what in ("a.tif: 3 pages", "a.tif: 3 pages", "b.tif: 2 pages"):
            warnings.warn(InputWarning(what), stacklevel=1)
        with pytest.raises(UserWarning, match="another"):
            warnings.warn("another", stacklevel=1)
    assert capsys.readouterr() == ("", "warning: a.tif: 3 pages\nwarning: b.tif: 2 pages\n")
    with pytest.raises(InputWarning):
        warnings.warn(InputWarning("a.tif: 3 pages"), stacklevel=1)


def test_table_in_a_pipe_has_whole_names(capsys, monkeypatch):
    """A terminal of 80 columns would show several rows alike."""
    monkeypatch.setenv("COLUMNS", "80")
    name = "hologlyph_top__PXL_20240225_141225262.MP_and_more_of_it_so_that_no_terminal_holds_it.jpg"
    say_table(("file", "ids"), [(name, ", ".join(map(str, range(60))))])
    assert capsys.readouterr().out.splitlines()[1].split()[0] == name


def test_table_keeps_brackets_and_is_empty_without_rows(capsys):
    say_table(("file", "markers"), [("[red].png", "3"), ("b.png", "12")], right_aligned=("markers",))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines] == [["file", "markers"], ["[red].png", "3"], ["b.png", "12"]]
    assert lines[1].index("3") == lines[2].index("12") + 1
    say_table(("file", "markers"), [])
    assert capsys.readouterr().out == ""


def report_files() -> None:
    with ProgressReporter() as progress:
        progress.update("[a].png", 1, 2)
        progress.update("[a].png", 2, 2)
        progress.update("b.mp4", 30, None)
        progress.update("b.mp4", 31, 60, "in the middle")


def test_progress_is_shown_on_terminals_only(capsys, monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    report_files()
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("words", [("[a].png", "2/2"), ("b.mp4", "in the middle")], ids=" ".join)
def test_progress_shows_name_and_fraction(words, monkeypatch):
    drawn = []
    monkeypatch.setenv("FORCE_COLOR", "1")
    with ProgressReporter() as progress:
        progress.update("[a].png", 1, 2)
        progress.update("[a].png", 2, 2)
        drawn.append(tasks(progress))
        progress.update("b.mp4", 31, 60, "in the middle")
        drawn.append(tasks(progress))
    assert words in [task for shown in drawn for task in shown]
    assert all(len(shown) == 1 for shown in drawn), "one bar at a time"


def tasks(progress: ProgressReporter) -> list[tuple[str, str]]:
    return [(task.description, task.fields["state"]) for task in progress._progress.tasks if task.visible]
