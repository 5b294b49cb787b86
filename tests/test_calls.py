"""No constructor is called with more than three positional numbers, whose wrong order is hard to see."""

import ast
import re
from collections.abc import Iterator

import pytest
from source_files import SOURCE_FILES, syntax_tree

MAX_NUMBERS = 3
"""Maximum number of positional numbers. Chosen: x, y and z, or a position and a size, are easy to read."""

UNITS = re.compile(r"_(m|px|s|rad|deg|mps|radps|hz|sides|cells|px2|m2|degps|ps)$")
"""Suffixes of names with which the project marks numbers."""


def is_number(node: ast.expr) -> bool:
    """Return whether an argument looks like a number: a literal, arithmetic, or a name with a unit."""
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) or is_number(node.right)
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
    return UNITS.search(name) is not None


def too_many_numbers(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call):
            continue
        called = node.func
        name = (
            called.id
            if isinstance(called, ast.Name)
            else called.attr
            if isinstance(called, ast.Attribute)
            else ""
        )
        if (name[:1].isupper() or name == "cls") and sum(map(is_number, node.args)) > MAX_NUMBERS:
            yield f"line {node.lineno}: {name}"


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("Box(1, 2, 3)", []),
        ("Box(1, 2, 3, 4)", ["line 1: Box"]),
        ("Box(1, 2, 3, height=4)", []),
        ("Box(left_px, -top_px, width_px, 2 * side_px)", ["line 1: Box"]),
        ("cls(a_m, b_m, c_m, d_m)", ["line 1: cls"]),
        ("draw(1, 2, 3, 4)", []),
    ],
)
def test_check_counts_positional_numbers(source, found) -> None:
    assert list(too_many_numbers(ast.parse(source))) == found


def test_constructors_get_numbers_by_name() -> None:
    found = {str(path): list(too_many_numbers(syntax_tree(path))) for path in SOURCE_FILES.values()}
    assert {path: lines for path, lines in found.items() if lines} == {}
