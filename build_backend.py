"""Build backend of skyherd: setuptools, which requires `ziglang` if no C compiler is on the path."""

import shutil

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403

COMPILERS = ("cc", "gcc", "clang")


def _requirements(others: list[str]) -> list[str]:
    return others if any(map(shutil.which, COMPILERS)) else [*others, "ziglang"]


def get_requires_for_build_wheel(config_settings=None):
    """Return the requirements of a build."""
    return _requirements(build_meta.get_requires_for_build_wheel(config_settings))


def get_requires_for_build_editable(config_settings=None):
    """Return the requirements of an editable build."""
    return _requirements(build_meta.get_requires_for_build_editable(config_settings))
