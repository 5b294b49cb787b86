"""The pages of the API reference: one for each package, with a section for each of its modules."""

import ast
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent


def packages() -> dict[str, Path]:
    """Return the folder of each package that has modules, by the package's full name."""
    places = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-dir"]
    folders = {}
    for name, place in sorted(places.items()):
        for init in (ROOT / place).rglob("__init__.py"):
            folders[".".join((name, *init.parent.relative_to(ROOT / place).parts))] = init.parent
    return {name: folder for name, folder in sorted(folders.items()) if modules(folder) or name == "skyherd"}


def modules(folder: Path) -> list[str]:
    """Names of the modules that lie in a folder, private ones left out."""
    return sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))


def api_page(package: str, folder: Path) -> str:
    """The page of one package: its docstring, the names that it offers, and its modules."""
    of_package = f"::: {package}\n    options:\n      members: false\n      show_root_heading: false\n"
    parts = [f"# `{package}`\n", of_package]
    if offered := offered_names(package, folder):
        parts.append("## Offered by the package itself\n")
        parts.append("\n".join(f"- [`{name}`][{module}.{name}]" for name, module in offered.items()) + "\n")
    parts += [f"::: {package}.{module}\n" for module in modules(folder)]
    return "\n".join(parts)


def offered_names(package: str, folder: Path) -> dict[str, str]:
    """The module that each name of a package's `__all__` comes from, in the order of the alphabet."""
    found: dict[str, str] = {}
    for node in ast.walk(ast.parse((folder / "__init__.py").read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("skyherd."):
            found |= {
                alias.name: home(node.module, alias.name) for alias in node.names if alias.name[0] != "_"
            }
    return dict(sorted(found.items()))


def home(module: str, name: str) -> str:
    """The module in which a name is defined: that of the import, or that which a package has it from."""
    folder = packages().get(module)
    return module if folder is None else offered_names(module, folder).get(name, module)


def overview() -> str:
    """The first page: the packages with the first sentence of each one's docstring."""
    rows = []
    for package, folder in packages().items():
        text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text())) or ""
        rows.append(f"| [`{package}`]({package}.md) | {' '.join(text.split(chr(10) * 2)[0].split())} |")
    return "\n".join(
        [
            "# Library reference\n",
            "One page for each package, made from the docstrings. [Architecture](../../architecture.md) says",
            "how the packages fit together, and who may import what. What most users need is in",
            "[`skyherd`](skyherd.md) itself.\n",
            "| package | |",
            "|---|---|",
            *rows,
            "",
        ]
    )
