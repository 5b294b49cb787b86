"""Source files of the package, by the full names of their modules, and their syntax trees."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PARTS = ("control", "datasets", "render", "vision")


def source_files() -> dict[str, Path]:
    """Return the file of each module of the package, by the module's full name."""
    files = {}
    for folder, package in (("src/skyherd", "skyherd"), *((part, f"skyherd.{part}") for part in PARTS)):
        for path in sorted((ROOT / folder).rglob("*.py")):
            names = path.relative_to(ROOT / folder).with_suffix("").parts
            names = names[:-1] if names[-1] == "__init__" else names
            files[".".join((package, *names))] = path
    return files


SOURCE_FILES = source_files()


@cache
def syntax_tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file, parsed once for all tests. Callers must not change it."""
    return ast.parse(path.read_text("utf-8"))
