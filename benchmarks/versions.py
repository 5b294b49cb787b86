"""Other versions of skyherd, unpacked from git and importable beside this one."""

import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from skyherd.errors import InputError


@contextmanager
def unpacked(reference: str, repository: Path) -> Iterator[Path]:
    """Unpack a version of skyherd, build its libraries, and give a folder from which it can be imported.

    Args:
        reference: of git: a commit, branch or tag.
        repository: folder of a git repository of skyherd.

    Raises:
        InputError: the folder is in no repository, or it has no such version, or that is not skyherd or
            cannot be built.
    """
    allowed = "a commit, branch or tag of a git repository of skyherd"
    if reference.startswith("-"):
        raise InputError(f"--against {reference}", "begins with a hyphen", allowed)
    try:
        packed = subprocess.run(
            ["git", "-C", str(repository), "archive", "--format=tar", f"{reference}^{{commit}}"],
            capture_output=True,
            check=False,
        )
    except FileNotFoundError:
        raise InputError("--against", "git is not installed", "an installed git") from None
    if packed.returncode:
        said = packed.stderr.decode(errors="replace").strip().splitlines() or ["git failed"]
        raise InputError(f"--against {reference}", said[0], allowed)
    with tempfile.TemporaryDirectory(prefix="skyherd-") as name:
        tree, folder = Path(name) / "tree", Path(name) / "importable"
        with tarfile.open(fileobj=BytesIO(packed.stdout)) as archive:
            archive.extractall(tree, filter="data")
        try:
            link_packages(tree, folder)
        except (OSError, KeyError, ValueError):
            raise InputError(f"--against {reference}", "has no package skyherd", allowed) from None
        build_libraries(tree, reference)
        yield folder


def build_libraries(tree: Path, reference: str) -> None:
    """Build the compiled libraries of an unpacked version, if it has any.

    Raises:
        InputError: the build fails.
    """
    build = tree / "src" / "skyherd" / "native" / "build.py"
    if not build.is_file():
        return
    built = subprocess.run([sys.executable, str(build)], capture_output=True, check=False)
    if built.returncode:
        said = built.stderr.decode(errors="replace").strip().splitlines() or ["the build failed"]
        raise InputError(f"--against {reference}", said[-1], "a version that can be built here")


def link_packages(tree: Path, folder: Path) -> None:
    """Link the packages of a source tree into a folder, from which they can then be imported.

    The tree is not changed. It may have links of its own, for editors, which are left out.

    Raises:
        OSError, KeyError, ValueError: the tree has no package skyherd.
    """
    tools = tomllib.loads((tree / "pyproject.toml").read_text("utf-8"))["tool"]
    places: dict[str, str] = tools["setuptools"]["package-dir"]
    top = f"{places['skyherd']}/"
    outside = {name: place for name, place in places.items() if not f"{place}/".startswith(top)}
    package = folder / "skyherd"
    package.mkdir(parents=True)
    for part in (tree / places["skyherd"]).iterdir():
        if f"skyherd.{part.name}" not in outside:
            (package / part.name).symlink_to(part, target_is_directory=part.is_dir())
    for name, place in sorted(outside.items()):
        target = folder.joinpath(*name.split("."))
        if not target.exists():
            target.symlink_to(tree / place, target_is_directory=True)
