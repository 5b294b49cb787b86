"""Find the packages of skyherd and build its compiled libraries; the rest is in `pyproject.toml`."""

import importlib.util
import tomllib
from pathlib import Path

from setuptools import Distribution, find_packages, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent

BUILD = ROOT / "src/skyherd/native/build.py"
"""Module that compiles the C sources."""


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


def build_libraries(into: Path | None) -> list[Path]:
    """Compile the C sources into a folder of packages, or beside the sources, and return the paths."""
    spec = importlib.util.spec_from_file_location("skyherd_native_build", BUILD)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.build(into)


class BuildWithLibraries(build_py):
    """Copy the packages, and compile the libraries beside their sources (in place if editable)."""

    def run(self) -> None:
        """Run the command."""
        super().run()
        self.libraries = build_libraries(None if self.editable_mode else Path(self.build_lib) / "skyherd")

    def get_outputs(self, include_bytecode: bool = True) -> list[str]:
        """Return the files that the command writes."""
        libraries = [] if self.editable_mode else [str(path) for path in getattr(self, "libraries", [])]
        return [*super().get_outputs(include_bytecode), *libraries]


class PlatformWheel(bdist_wheel):
    """Wheel for one platform and any Python, since the libraries do not use Python's C interface."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return the tag of the wheel: Python, binary interface, platform."""
        return "py3", "none", super().get_tag()[2]


class PlatformDistribution(Distribution):
    """Distribution with compiled files."""

    def has_ext_modules(self) -> bool:
        """Return True: the wheel has compiled files, which setuptools does not know of."""
        return True


if __name__ == "__main__":
    commands = {"build_py": BuildWithLibraries, "bdist_wheel": PlatformWheel}
    setup(packages=packages(), cmdclass=commands, distclass=PlatformDistribution)
