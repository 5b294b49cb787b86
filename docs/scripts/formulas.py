r"""Formulas of the site as MathML, which browsers show without a script.

`pymdownx.arithmatex` leaves TeX between `\(` and `\)`, or between `\[` and `\]`, for MathJax. Without MathJax
a page would show this TeX. So the TeX moves into an attribute, and MathML takes its place. `docs/formulas.js`
restores the TeX once MathJax is loaded.
"""

import re
from html import escape, unescape
from xml.etree import ElementTree

from latex2mathml.converter import convert

FORMULA = re.compile(r'<(span|div) class="arithmatex">(\\[(\[])(.*?)(\\[)\]])</\1>', re.DOTALL)
"""A formula as arithmatex writes it: tag, delimiters, and between them the TeX, escaped for HTML."""


def with_mathml(html: str) -> str:
    """Return a page in which each formula is MathML and keeps its TeX in `data-tex`.

    Raises:
        ValueError: a formula cannot be converted.
    """
    return FORMULA.sub(_formula, html)


def _formula(found: re.Match[str]) -> str:
    """Return one formula as MathML within its tag."""
    tag, opening, text, closing = found.groups()
    tex = unescape(text).strip()
    mathml = convert(tex, display="block" if tag == "div" else "inline")
    try:
        ElementTree.fromstring(mathml)
    except ElementTree.ParseError as error:
        raise ValueError(
            f"formula {tex!r}: no MathML can be made of it; write it without alignment"
        ) from error
    attribute = escape(f"{opening}{tex}{closing}")
    return f'<{tag} class="arithmatex" data-tex="{attribute}">{mathml}</{tag}>'
