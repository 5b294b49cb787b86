"""Sanitizing of external texts for display."""

import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.errors import MAX_CHARACTERS, InputError
from skyherd.text import one_of, printable, shorten, table_cell


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a b ä 漢 →", "a b ä 漢 →"),
        ("\x1b[31mred\n", r"\x1b[31mred\x0a"),
        ("\udcff.png", r"\xff.png"),
        ("gpj\u202e.exe\u2028", r"gpj\u202e.exe\u2028"),
        ("\ud800\U000e0001", r"\ud800\U000e0001"),
        ("[red]", "[red]"),
    ],
)
def test_control_and_hidden_characters_are_escaped(text, shown):
    assert printable(text) == shown


@given(st.text(st.characters(codec=None)))
def test_shown_text_is_encodable_and_one_line(text):
    shown = printable(text)
    shown.encode("utf-8")
    assert len(shown.splitlines()) <= 1 and "\x1b" not in shown
    assert printable(shown) == shown


@given(st.text(max_size=60), st.integers(1, 50))
def test_shortened_text_keeps_beginning_and_end(text, most):
    short = shorten(text, most)
    assert len(short) <= most
    if len(text) > most:
        head, tail = short.split("…", 1) if text.count("…") == 0 else (short[:1], short[-1:])
        assert text.startswith(head.removesuffix("…")) and text.endswith(tail.removeprefix("…"))
    else:
        assert short == text


@given(st.text(st.characters(codec=None)))
def test_cell_is_no_formula_and_survives_csv(text):
    cell = table_cell(text)
    assert not cell.startswith(("=", "+", "-", "@", "\t", "\r"))
    stream = io.StringIO()
    csv.writer(stream).writerow([cell, "x"])
    assert next(csv.reader(io.StringIO(stream.getvalue()))) == [cell, "x"]


@given(st.text(max_size=2000), st.text(max_size=2000), st.text(max_size=2000))
def test_input_error_is_short(where, what, allowed):
    error = InputError(where, what, allowed)
    assert len(str(error)) <= MAX_CHARACTERS + 4
    if len(where) + len(what) + len(allowed) <= MAX_CHARACTERS:
        one_line = what.replace("\n", " ")
        assert str(error) == f"{where}: {one_line}; {allowed}"


def test_only_the_longest_part_is_shortened():
    error = InputError("a.toml: key", "x" * 100_000, "1 or more")
    assert (error.where, error.allowed) == ("a.toml: key", "1 or more")
    assert len(str(error)) <= MAX_CHARACTERS + 4


def test_error_of_a_multiline_value_is_one_line():
    error = InputError("border bits", "array([[0.],\n       [0.]])", "a whole number")
    assert "\n" not in str(error) and str(error).startswith("border bits: array([[0.], ")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("strat", "did you mean 'star'? one of star, Line"),
        ("LINE", "did you mean 'Line'? one of star, Line"),
        ("qqq", "one of star, Line"),
        ("", "one of star, Line"),
        ("s" * 100_000, "one of star, Line"),
    ],
)
def test_refusal_lists_nearest_known_name_first(name, said):
    assert one_of(name, ["star", "Line"]) == said
