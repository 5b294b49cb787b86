"""Sanitizing of external text (file names, user values) for display.

A file name may hold line breaks, terminal escape sequences, bidirectional marks, and bytes that are not
UTF-8, which Python keeps as lone surrogates. `printable` escapes all of these. `shorten` keeps the beginning
and the end of a long text.
"""

import unicodedata
from collections.abc import Iterable
from difflib import get_close_matches

SURROGATES = range(0xDC80, 0xDD00)
"""Code points of the bytes 0x80 to 0xff of a name that is not UTF-8. *Defined* by Python's error handler
`surrogateescape`."""

HIDDEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Escaped Unicode categories: control and format characters, surrogates, line and paragraph separators.
*Chosen*: everything that a terminal interprets or does not show."""

MAX_COMPARED = 60
"""Characters of a name that are compared with known names. *Chosen*: longer than any known name."""

FORMULA_STARTS = ("=", "+", "-", "@")
"""First characters that make spreadsheets read a text as a formula. *Defined* by the spreadsheets."""


def printable(text: str, keep: str = "") -> str:
    r"""Return a text with all control and hidden characters escaped, such as `\x1b`.

    A byte that is not UTF-8 is shown as that byte, such as `\xff`. The result can always be encoded.

    Args:
        text: any text.
        keep: characters that are not escaped, such as a line break.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(char if char in keep else _escaped(char) for char in text)


def _escaped(char: str) -> str:
    if unicodedata.category(char) not in HIDDEN:
        return char
    code = ord(char)
    if code in SURROGATES:
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def shorten(text: str, most: int) -> str:
    """Return a text of at most `most` characters: the beginning, an ellipsis and the end if longer."""
    if len(text) <= most:
        return text
    tail = (most - 1) // 3
    return f"{text[: most - 1 - tail]}…{text[len(text) - tail :]}"


def table_cell(text: str) -> str:
    """Return a text for tables read by people and spreadsheets: printable, and never a formula.

    A text that a spreadsheet would read as a formula is prefixed with an apostrophe, the mark of plain text.
    """
    text = printable(text)
    return f"'{text}" if text.startswith(FORMULA_STARTS) else text


def did_you_mean(name: str, known: Iterable[object]) -> str:
    """Return `did you mean 'k'?` for the known name that is most like a name; empty if none is like it."""
    lower = {str(one).lower(): str(one) for one in known}
    close = get_close_matches(shorten(name.lower(), MAX_COMPARED), lower, 1)
    return f"did you mean {lower[close[0]]!r}?" if close else ""


def one_of(name: str, known: Iterable[object]) -> str:
    """Return the known names as a problem lists them, after the one that is most like a wrong name."""
    names = list(map(str, known))
    return " ".join(filter(None, (did_you_mean(name, names), f"one of {', '.join(names)}")))
