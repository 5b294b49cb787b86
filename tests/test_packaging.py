"""Packaging: the package list matches the tree; the wheel has skyherd alone, and its compiled libraries."""

import ast
import importlib.util
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import skyherd
from skyherd.native import build
from skyherd.native.loading import load

ROOT = Path(__file__).parent.parent
SETUP = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]


def folders_with_code():
    for top, package in (("src/skyherd", "skyherd"), *((p, f"skyherd.{p}") for p in PARTS)):
        for init in sorted((ROOT / top).rglob("__init__.py")):
            tail = init.parent.relative_to(ROOT / top).parts
            yield ".".join((package, *tail)), init.parent.relative_to(ROOT).as_posix()


PARTS = ("vision", "control", "render", "datasets")


def discovered(root):
    """Return the packages that `setup.py` of a source tree finds."""
    spec = importlib.util.spec_from_file_location("setup_of_tree", root / "setup.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.packages()


@pytest.mark.smoke
def test_setup_finds_every_package_of_the_tree():
    assert discovered(ROOT) == sorted(dict(folders_with_code()))
    places = {f"skyherd.{part}": part for part in PARTS} | {"skyherd": "src/skyherd"}
    assert SETUP["package-dir"] == places


@pytest.fixture
def small_tree(tmp_path):
    """Write a source tree with seven packages, and the two scripts of the project."""
    tops = ("src/skyherd", *PARTS)
    for folder in (*tops, "src/skyherd/sim", "vision/search"):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / ".ci").mkdir()
    for file in ("pyproject.toml", "setup.py", ".ci/link_packages.py"):
        shutil.copy(ROOT / file, tmp_path / file)
    return tmp_path


def link_packages(root, *options):
    command = [sys.executable, root / ".ci" / "link_packages.py", *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_setup_leaves_linked_folders_out(small_tree):
    before = discovered(small_tree)
    assert "skyherd.vision.search" in before and len(before) == 7
    assert link_packages(small_tree).returncode == 0
    assert (small_tree / "src/skyherd/vision/search/__init__.py").exists()
    assert discovered(small_tree) == before
    (small_tree / "src/skyherd/sim/new").mkdir()
    (small_tree / "src/skyherd/sim/new/__init__.py").touch()
    assert discovered(small_tree) == sorted([*before, "skyherd.sim.new"])


def test_links_are_made_twice_and_removed_alone(small_tree):
    for _ in range(2):
        assert link_packages(small_tree).returncode == 0
    assert link_packages(small_tree, "--remove").returncode == 0
    assert sorted(path.name for path in (small_tree / "src/skyherd").iterdir()) == ["__init__.py", "sim"]
    assert (small_tree / "vision/search/__init__.py").exists()


def test_link_over_another_folder_is_refused(small_tree):
    (small_tree / "src/skyherd/render").mkdir()
    ended = link_packages(small_tree)
    assert ended.returncode == 1 and "remove it" in ended.stderr and len(ended.stderr.splitlines()) == 1


def test_version_has_one_source():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "skyherd.version.__version__"}
    assert f"## {skyherd.__version__} " in (ROOT / "CHANGELOG.md").read_text()


@pytest.fixture(scope="module")
def wheel_path(tmp_path_factory):
    """Return the path of the wheel `SKYHERD_WHEEL`, or of a new one."""
    made = os.environ.get("SKYHERD_WHEEL")
    if made:
        return Path(made)
    out = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(out), str(ROOT)],
        check=True,
        capture_output=True,
    )
    return next(out.glob("*.whl"))


@pytest.fixture(scope="module")
def wheel(wheel_path):
    """Return the file names of the wheel."""
    return zipfile.ZipFile(wheel_path).namelist()


@pytest.mark.slow
def test_wheel_is_for_one_platform_and_has_loadable_libraries(wheel, wheel_path, tmp_path):
    tag = wheel_path.stem.split("-", 2)[2]
    assert tag.startswith("py3-none-") and not tag.endswith("any")
    for package in build.LIBRARIES:
        names = [f"skyherd/{package}/native/{build.library_name(package, level)}" for level in build.levels()]
        assert set(names) <= set(wheel)
        zipfile.ZipFile(wheel_path).extract(names[0], tmp_path)
        assert load(tmp_path / names[0], build.sources_folder(package)).processor_level() >= 0


@pytest.mark.parametrize("compiler", [None, "cc", "clang"])
def test_build_requires_ziglang_only_without_a_compiler(compiler, tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("build_backend", ROOT / "build_backend.py")
    backend = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(backend)
    if compiler:
        (tmp_path / compiler).touch(mode=0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert backend.COMPILERS == build.COMPILERS
    assert backend._requirements([]) == ([] if compiler else ["ziglang"])


@pytest.mark.slow
def test_wheel_has_all_files_under_skyherd_only(wheel):
    tops = {name.split("/")[0] for name in wheel}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"skyherd"}
    for package, folder in folders_with_code():
        for file in (ROOT / folder).iterdir():
            if file.suffix in {".py", ".toml", ".typed", ".html", ".css", ".c", ".h"}:
                inside = file.relative_to(ROOT / folder).as_posix()
                assert f"{package.replace('.', '/')}/{inside}" in wheel


def imported_modules(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or ""
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.smoke
def test_control_imports_neither_pixels_nor_world():
    """The test is independent of the import contracts, which the gate checks with a planted leak."""
    allowed = ("skyherd.control", "skyherd.errors", "skyherd.geometry", "skyherd.messages")
    for path in (ROOT / "control").rglob("*.py"):
        ours = [name for name in imported_modules(path) if name.startswith("skyherd")]
        assert all(name.startswith(allowed) for name in ours), (path.name, ours)
        assert not any(name.startswith("cv2") for name in imported_modules(path)), path.name
