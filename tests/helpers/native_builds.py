"""Builds of a compiled library."""

from skyherd.native import build
from skyherd.native.loading import library_of, load


def builds(package, declared):
    """Return the libraries of a package that this processor can load, by level, with `declared` functions."""
    best, folder = int(library_of(package).processor_level()), build.sources_folder(package)
    return {
        level: declared(load(folder / build.library_name(package, level), folder))
        for level in build.levels()
        if level <= best
    }
