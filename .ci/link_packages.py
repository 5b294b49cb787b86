"""Link the folders of packages that lie outside of `src/skyherd` into it, for editors and type checkers.

    python .ci/link_packages.py [--remove]

In a checkout, mypy, import-linter and most editors look for `skyherd.vision` in `src/skyherd/vision`, but its
folder is `vision/`. With these links, `mypy -p skyherd` and `lint-imports` run in the checkout. Git ignores
them, and the wheel leaves them out. On Windows they are junctions, which need no privilege.
"""

import argparse
import os
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def links() -> dict[Path, Path]:
    """Return the place of each link, and the folder that it leads to."""
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    places: dict[str, str] = tools["setuptools"]["package-dir"]
    top = ROOT / places.pop("skyherd")
    return {top.joinpath(*name.split(".")[1:]): ROOT / folder for name, folder in places.items()}


def make(link: Path, folder: Path) -> None:
    """Make a link to a folder, unless it is there.

    Raises:
        OSError: something else has the link's name, or the link cannot be made.
    """
    if link.exists() and link.samefile(folder):
        return
    if os.path.lexists(link):
        raise FileExistsError(f"{link} is there, and is no link to {folder}; remove it")
    if sys.platform == "win32":
        command = ["cmd", "/c", "mklink", "/J", str(link), str(folder)]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise OSError(f"{link}: mklink failed: {ended.stderr.strip()}")
    else:
        link.symlink_to(os.path.relpath(folder, link.parent), target_is_directory=True)


def remove(link: Path, folder: Path) -> None:
    """Remove a link to a folder, and nothing else."""
    if link.is_symlink():
        link.unlink()
    elif link.exists() and link.samefile(folder):  # a junction, which is removed as an empty folder is
        link.rmdir()


def main() -> int:
    """Make or remove the links, and return the exit code."""
    parser = argparse.ArgumentParser(description="Link the mapped packages into src/skyherd.")
    parser.add_argument("--remove", action="store_true", help="remove the links")
    change = remove if parser.parse_args().remove else make
    try:
        for link, folder in links().items():
            change(link, folder)
        if change is remove:
            print("An editable install that was made with the links needs them: run pip install -e . again.")
    except OSError as error:
        print(f"link_packages: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
