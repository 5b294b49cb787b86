"""Template engine of the pages: inserted text is escaped, and markup is in templates only."""

import ast
from importlib.resources import files
from pathlib import Path

import jinja2
import pytest

import skyherd
from skyherd.report.pages import data_uri, render_page

PAGES = {
    "skyherd.report": {"report.html": "base.html"},
    "skyherd.bench": {
        "measurement.html": "base.html",
        "bench.html": "measurement.html",
        "boards.html": "measurement.html",
        "photographs.html": "measurement.html",
    },
    "skyherd.live.review": {"live.html": "base.html"},
    "skyherd.study": {
        "study.html": "base.html",
        "invariance.html": "study.html",
        "methods.html": "study.html",
    },
}
"""Templates of each package, with their base templates."""
HOSTILE = '<script>alert(1)</script> & "quoted" {{ title }}'


@pytest.mark.parametrize("package", PAGES)
def test_every_page_extends_base_and_uses_autoescape(package: str) -> None:
    templates = files(package).joinpath("templates")
    found = {file.name for file in templates.iterdir() if file.name.endswith(".html")}
    assert found - {"base.html", "parts.html"} == PAGES[package].keys()
    for template, base in PAGES[package].items():
        text = templates.joinpath(template).read_text("utf-8")
        assert f'{{% extends "{base}" %}}' in text
        assert "safe" not in text and "autoescape" not in text


@pytest.mark.smoke
def test_inserted_text_never_becomes_markup() -> None:
    table = {"title": HOSTILE, "note": HOSTILE, "header": [HOSTILE, HOSTILE], "rows": [[HOSTILE, HOSTILE]]}
    values = {"tiles": [], "figures": [], "tables": [table], "environment": [(HOSTILE, HOSTILE)]}
    values |= {"refused": [(HOSTILE, HOSTILE, HOSTILE)]}
    page = render_page("skyherd.bench", "bench.html", title=HOSTILE, **values)
    assert page.startswith("<!DOCTYPE html>")
    assert "<script" not in page
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt; &amp; ") >= 12
    assert "{{ title }}" in page


def test_missing_template_value_is_an_error() -> None:
    with pytest.raises(jinja2.UndefinedError, match="tiles"):
        render_page("skyherd.bench", "bench.html", title="bench")


def test_python_code_holds_no_markup() -> None:
    """No text of the package except docstrings has an HTML tag."""
    root = Path(skyherd.__file__).parent
    for file in root.rglob("*.py"):
        tree = ast.parse(file.read_text("utf-8"))
        docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        texts = [
            node.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
        ]
        assert not [text for text in texts if "</" in text or "<div" in text or "<t" in text], file


def test_file_becomes_data_uri(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"\x00\x01")
    assert data_uri(tmp_path / "a.png", "image/png") == "data:image/png;base64,AAE="
