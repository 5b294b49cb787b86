"""Build the pages of the API reference: one page per package, one section per module."""

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent


def packages() -> dict[str, Path]:
    """Return the folder of each package with modules, by full name, from `pyproject.toml`."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-dir"]
    folders = {name: ROOT / folder for name, folder in listed.items()}
    return {name: folder for name, folder in sorted(folders.items()) if modules(folder) or name == "skyherd"}


def modules(folder: Path) -> list[str]:
    """Return the names of the public modules in a folder."""
    return sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))


def api_page(package: str, folder: Path) -> str:
    """Return the page of one package: docstring, public names and modules."""
    of_package = f"::: {package}\n    options:\n      members: false\n      show_root_heading: false\n"
    parts = [f"# `{package}`\n", of_package]
    if offered := offered_names(package, folder):
        parts.append("## Public names\n")
        parts.append("\n".join(f"- [`{name}`][{module}.{name}]" for name, module in offered.items()) + "\n")
    parts += [f"::: {package}.{module}\n" for module in modules(folder)]
    return "\n".join(parts)


def offered_names(package: str, folder: Path) -> dict[str, str]:
    """Return the defining module of each name in a package's `__all__`, sorted by name."""
    found: dict[str, str] = {}
    for node in ast.walk(ast.parse((folder / "__init__.py").read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("skyherd."):
            found |= {
                alias.name: home(node.module, alias.name) for alias in node.names if alias.name[0] != "_"
            }
    return dict(sorted(found.items()))


def home(module: str, name: str) -> str:
    """Return the module that defines a name, following re-exports."""
    folder = packages().get(module)
    return module if folder is None else offered_names(module, folder).get(name, module)


def overview() -> str:
    """Return the index page: all packages with the first sentence of their docstrings."""
    rows = []
    for package, folder in packages().items():
        text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
        rows.append(f"| [`{package}`]({package}.md) | {' '.join(text.split(chr(10) * 2)[0].split())} |")
    return "\n".join(
        [
            "# Library reference\n",
            "One page per package, generated from the docstrings. [`skyherd`](skyherd.md) has the main API.",
            "[Architecture](../../architecture.md) explains the packages and their imports.\n",
            "| package | |",
            "|---|---|",
            *rows,
            "",
        ]
    )
