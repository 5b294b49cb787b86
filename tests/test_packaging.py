"""The package list is the tree, the wheel holds nothing at its top but skyherd, and truth does not leak."""

import ast
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import skyherd

ROOT = Path(__file__).parent.parent
SETUP = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]


def folders_with_code():
    for top, package in (("src/skyherd", "skyherd"), *((p, f"skyherd.{p}") for p in PARTS)):
        for init in sorted((ROOT / top).rglob("__init__.py")):
            tail = init.parent.relative_to(ROOT / top).parts
            yield ".".join((package, *tail)), init.parent.relative_to(ROOT).as_posix()


PARTS = ("vision", "control", "render", "datasets")


def test_every_package_of_the_tree_is_listed_where_it_lies():
    tree = dict(folders_with_code())
    assert sorted(tree) == sorted(SETUP["packages"])
    assert tree == SETUP["package-dir"]


def test_the_version_has_one_source():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "skyherd.version.__version__"}
    assert f"## {skyherd.__version__} " in (ROOT / "CHANGELOG.md").read_text()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The names of the files in the wheel: in the one that `SKYHERD_WHEEL` names, or in one made here."""
    made = os.environ.get("SKYHERD_WHEEL")
    if made:
        return zipfile.ZipFile(made).namelist()
    out = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)],
        check=True,
        capture_output=True,
    )
    return zipfile.ZipFile(next(out.glob("*.whl"))).namelist()


@pytest.mark.slow
def test_the_wheel_holds_all_files_under_skyherd_and_nothing_beside(wheel):
    tops = {name.split("/")[0] for name in wheel}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"skyherd"}
    for package, folder in folders_with_code():
        for file in (ROOT / folder).iterdir():
            if file.suffix in {".py", ".toml", ".typed", ".html", ".css"}:
                inside = file.relative_to(ROOT / folder).as_posix()
                assert f"{package.replace('.', '/')}/{inside}" in wheel


def imported_modules(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_control_imports_neither_pixels_nor_world():
    """Independent of the import contracts, which the gate checks with a planted leak as well."""
    allowed = ("skyherd.control", "skyherd.errors", "skyherd.geometry", "skyherd.messages")
    for path in (ROOT / "control").rglob("*.py"):
        ours = [name for name in imported_modules(path) if name.startswith("skyherd")]
        assert all(name.startswith(allowed) for name in ours), (path.name, ours)
        assert not any(name.startswith("cv2") for name in imported_modules(path)), path.name
