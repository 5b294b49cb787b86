"""Find the packages of skyherd; everything else about the distribution is in `pyproject.toml`."""

import tomllib
from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).parent


def packages() -> list[str]:
    """Return the names of all packages, by the top folders that `package-dir` names.

    Links to these folders in another one, which `.ci/link_packages.py` makes, are left out.
    """
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    places: dict[str, str] = tools["setuptools"]["package-dir"]
    found = []
    for package, folder in places.items():
        prefix = f"{package}."
        nested = [name.removeprefix(prefix) for name in places if name.startswith(prefix)]
        linked = [pattern for name in nested for pattern in (name, f"{name}.*")]
        inside = find_packages(str(ROOT / folder), exclude=linked)
        found += [package, *(f"{prefix}{name}" for name in inside)]
    return sorted(found)


if __name__ == "__main__":
    setup(packages=packages())
