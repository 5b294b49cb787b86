"""Help texts: whole lines, no Python types, sentences, verbs in groups, options with one name each."""

import re

import pytest
import typer
from command_line import call, verbs

from skyherd.cli import app
from skyherd.cli.help import summary, write_rows

GROUP = typer.main.get_command(app)
ALL = list(verbs())


@pytest.mark.parametrize("columns", [80, 100])
@pytest.mark.parametrize("words", [words for words, _ in ALL], ids=" ".join)
def test_help_has_whole_lines_and_no_python_types(words, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    code, said, err = call(capsys, *words, "--help")
    assert (code, err) == (0, "")
    for line in said.splitlines():
        assert len(line) <= columns and not line.endswith("-"), line
    assert not re.search(r"<\w|\{|\blist\[|<=|\[required\]\n\s*\[", said), said
    assert "..." not in re.sub(r"(ARGS\]|VIDEO\|BAG|SCENARIO\]|PICTURE\|VIDEO\|BAG)\.\.\.", "", said)


@pytest.mark.parametrize(
    ("words", "command"), ALL, ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_help_texts_are_sentences(words, command):
    assert summary(command).endswith(".")
    for parameter in command.params:
        text = parameter.help or ""
        assert re.fullmatch(r"[A-Z(`].*[.…]", text), (words, parameter.name, text)


@pytest.mark.parametrize(
    ("words", "command"), ALL[1:], ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_option_values_have_names(words, command):
    for parameter in command.params:
        if not getattr(parameter, "is_flag", False):
            assert parameter.metavar, (words, parameter.name)


def test_verbs_are_grouped_with_one_line_each(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    said = call(capsys, "--help")[1]
    titles = re.findall(r"^(\S.*):$", said, re.M)
    assert titles == ["Options", "Simulate", "Detect and measure", "Steer real robots", "Data and reports"]
    for name, command in GROUP.commands.items():
        assert re.search(rf"^  {name} +{re.escape(summary(command))}$", said, re.M), name


NAMES = {
    "out_dir": "--out",
    "out_file": "--out",
    "picture": "--out",
    "settings": "--set",
    "seed": "--seed",
    "jobs": "--jobs",
    "duration_s": "--duration",
    "force": "--force",
    "dictionary": "--dictionary",
    "names": "--detectors",
}
"""Options by the parameters of verbs."""


def test_options_with_equal_meaning_share_a_name():
    found = set()
    for _, command in ALL:
        for parameter in command.params:
            if parameter.name in NAMES and parameter.param_type_name == "option":
                assert NAMES[parameter.name] in parameter.opts
                found.add(parameter.name)
    assert found == set(NAMES)


@pytest.mark.parametrize(
    ("rows", "lines"),
    [
        ([("a", "opencv-apriltag opencv-subpix")], ["  a   opencv-apriltag", "      opencv-subpix"]),
        ([("longer", "text")], ["  longer", "      text"]),
        ([("a", "")], ["  a"]),
    ],
)
def test_help_rows_break_only_between_words(rows, lines):
    class Formatter:
        width = 24
        text = ""

        def write(self, text):
            self.text += text

    formatter = Formatter()
    write_rows("Title", rows, formatter, 2)
    assert formatter.text.splitlines() == ["", "Title:", *lines]
