"""The pages of the API reference: one for each package, with a section for each of its modules."""

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent

PLACES: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"][
    "package-dir"
]
"""Folders of packages outside the folder of the package that contains them, by the package's full name."""


def packages() -> dict[str, Path]:
    """Return the folder of each package that has modules, by the package's full name."""
    folders = {}
    for name, place in sorted(PLACES.items()):
        for init in (ROOT / place).rglob("__init__.py"):
            folders[".".join((name, *init.parent.relative_to(ROOT / place).parts))] = init.parent
    return {name: folder for name, folder in sorted(folders.items()) if modules(folder) or name == "skyherd"}


def modules(folder: Path) -> list[str]:
    """Return the names of the public modules in a folder."""
    return sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))


def api_page(package: str, folder: Path) -> str:
    """Return the page of one package: its docstring, the names that it offers, and its modules."""
    of_package = f"::: {package}\n    options:\n      members: false\n      show_root_heading: false\n"
    parts = [f"# `{package}`\n", of_package]
    if offered := offered_names(package, folder):
        parts.append("## Offered by the package itself\n")
        parts.append("\n".join(f"- [`{name}`][{module}.{name}]" for name, module in offered.items()) + "\n")
    parts += [f"::: {package}.{module}\n" for module in modules(folder)]
    return "\n".join(parts)


def offered_names(package: str, folder: Path) -> dict[str, str]:
    """Return the module of each name in a package's `__all__`, in alphabetical order."""
    found: dict[str, str] = {}
    for node in ast.walk(ast.parse((folder / "__init__.py").read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("skyherd."):
            found |= {
                alias.name: home(node.module, alias.name) for alias in node.names if alias.name[0] != "_"
            }
    return dict(sorted(found.items()))


def home(module: str, name: str) -> str:
    """Return the module that defines a name: the imported module, or the one that its package imports."""
    place = max((top for top in PLACES if f"{module}.".startswith(f"{top}.")), key=len)
    folder = ROOT / PLACES[place] / module.removeprefix(place).lstrip(".").replace(".", "/")
    return offered_names(module, folder).get(name, module) if folder.is_dir() else module


PUBLIC = {
    "Run a scenario": (
        "load_mission",
        "scenario_names",
        "run_steps",
        "run_mission",
        "read_recording",
        "Mission",
        "Step",
    ),
    "Find markers": ("detect", "annotate", "create_detector", "Detections", "Detection", "read_dataset"),
    "Control": (
        "AerialController",
        "Decision",
        "Template",
        "shape_points",
        "SafetyRadius",
        "Hover",
        "Rectifier",
        "GoalInboxes",
        "MarkerGains",
        "robot_commands",
    ),
    "Messages": ("MotionGoals", "UnitReport", "VelocityCommand"),
    "Errors": ("InputError", "SkyherdError"),
}
"""The names that `import skyherd` offers, by purpose; a test compares them with `skyherd.__all__`."""


PUBLIC_OPTIONS = """\
    options:
      filters: ["!^_"]
      heading_level: 3
      show_if_no_docstring: false
      show_root_full_path: false
      show_source: false
      skip_local_inventory: true
"""
"""How the public page shows a name: without its module, and not as the target of links from other pages."""


def public_page() -> str:
    """Return the page of the public API: each name with its signature and docstring, without source."""
    homes = offered_names("skyherd", ROOT / "src/skyherd")
    parts = [
        "# Public API\n",
        "`import skyherd` offers these names, and loads each at its first use. Most programs need no others.",
        "[Use it as a library](../how-to/library.md) has examples. The pages of the",
        "[internal packages](api/index.md) have everything else.\n",
    ]
    for title, names in PUBLIC.items():
        parts.append(f"## {title}\n")
        parts += [f"::: {homes[name]}.{name}\n{PUBLIC_OPTIONS}" for name in names]
    return "\n".join(parts)


def overview() -> str:
    """Return the first page: each package with the first sentence of its docstring."""
    rows = []
    for package, folder in packages().items():
        text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
        rows.append(f"| [`{package}`]({package}.md) | {' '.join(text.split(chr(10) * 2)[0].split())} |")
    return "\n".join(
        [
            "# Internal packages\n",
            "One page for each package, made from the docstrings. [Architecture](../../architecture.md) says",
            "how the packages fit together, and which may import which. Most programs need only the",
            "[public API](../library.md).\n",
            "| package | |",
            "|---|---|",
            *rows,
            "",
        ]
    )
