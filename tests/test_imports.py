"""Imports within the package: facades, and few layers without cycles.

The tests are independent of the import contracts of `pyproject.toml`. They read the source files, including
imports inside functions and for type checkers.
"""

import ast
import tomllib
from graphlib import CycleError, TopologicalSorter

import pytest
from source_files import ROOT, SOURCE_FILES, syntax_tree

FACADES = ("control", "render", "vision")
"""Packages whose names are imported from the package itself: `from skyherd.control import Template`."""

MAX_CHILDREN = 35
"""Maximum number of modules and packages directly under `skyherd`. Chosen: easy to survey."""

MAX_LAYERS = 18
"""Maximum number of layers of the exhaustive import contract. Chosen."""


def imports(tree: ast.Module, modules: set[str]) -> set[str]:
    """Return modules of the package that a file imports anywhere; a name that is a module counts."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= (names & modules) or {node.module}
            found |= {node.module} if names - modules else set()
    return {name for name in found if name == "skyherd" or name.startswith("skyherd.")}


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    """Return the imported modules of the package by module."""
    modules = set(SOURCE_FILES)
    return {module: imports(syntax_tree(path), modules) for module, path in SOURCE_FILES.items()}


def belongs_to(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def ways_past_facades(graph: dict[str, set[str]]) -> set[tuple[str, str]]:
    """Return imports of a module inside `control`, `render` or `vision` from outside of it."""
    facades = [f"skyherd.{name}" for name in FACADES]
    return {
        (module, target)
        for module, targets in graph.items()
        for target in targets
        for facade in facades
        if target.startswith(f"{facade}.") and not belongs_to(module, facade)
    }


@pytest.mark.smoke
def test_no_module_imports_past_a_facade(graph) -> None:
    past = ways_past_facades(graph)
    assert past == set(), "import these names from the package itself, or export them there"


@pytest.mark.parametrize(
    ("statement", "past"),
    [
        ("from skyherd.control import Template", False),
        ("from skyherd.control.formation.template import Template", True),
        ("from skyherd.control.formation import template", True),
        ("from skyherd.control import formation", True),
        ("import skyherd.control.formation.template", True),
        ("def f():\n    from skyherd.control.formation.template import Template", True),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import skyherd.vision.grey", True),
    ],
)
def test_import_past_a_facade_is_detected(statement, past) -> None:
    modules = set(SOURCE_FILES)
    outside = {"skyherd.report.pages": imports(ast.parse(statement), modules)}
    assert bool(ways_past_facades(outside)) is past
    statement = statement.replace("vision.grey", "control.goals")
    assert not ways_past_facades({"skyherd.control.goals": imports(ast.parse(statement), modules)})


def child_of(module: str) -> str | None:
    """Return the direct child of `skyherd` that contains a module; None for the package itself."""
    return module.split(".")[1] if "." in module else None


CHILDREN = {child for child in map(child_of, SOURCE_FILES) if child is not None}


def child_graph(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the imports among the direct children of `skyherd`, without those of the lazy package itself."""
    found: dict[str, set[str]] = {}
    for module, targets in graph.items():
        if (child := child_of(module)) is not None:
            others = {child_of(target) for target in targets} - {None, child}
            found.setdefault(child, set()).update(others)
    return found


def layer_of() -> dict[str, int]:
    """Return the layer of each child, the lowest 0, by the exhaustive contract of `pyproject.toml`."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    contract = next(one for one in tool["contracts"] if one["type"] == "layers")
    assert contract["containers"] == ["skyherd"]
    assert contract["exhaustive"] is True
    lowest_first = reversed(contract["layers"])
    return {name.strip(): row for row, layer in enumerate(lowest_first) for name in layer.split("|")}


def test_package_has_few_children_on_few_layers() -> None:
    layers = layer_of()
    assert set(layers) == CHILDREN, "each child of skyherd has its place, and no place is empty"
    assert len(CHILDREN) <= MAX_CHILDREN
    assert max(layers.values()) + 1 <= MAX_LAYERS


def upward(graph: dict[str, set[str]], layers: dict[str, int]) -> set[tuple[str, str]]:
    """Return imports of a child on the same layer or a higher one."""
    return {(child, to) for child, targets in graph.items() for to in targets if layers[to] >= layers[child]}


@pytest.mark.smoke
def test_packages_have_no_upward_import_and_no_cycle(graph) -> None:
    rooms = child_graph(graph)
    assert upward(rooms, layer_of()) == set()
    TopologicalSorter(rooms).prepare()
    rooms["geometry"].add("loop")
    assert ("geometry", "loop") in upward(rooms, layer_of())
    with pytest.raises(CycleError):
        TopologicalSorter(rooms).prepare()


def test_modules_have_no_import_cycle(graph) -> None:
    """A package is the module of its `__init__`; an import from the package is one of that module."""
    TopologicalSorter({module: targets - {module, "skyherd"} for module, targets in graph.items()}).prepare()
