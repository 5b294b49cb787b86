"""Loading of the compiled libraries by ctypes, with the types of their functions.

The library for the processor's instruction set is loaded at the first call. All builds give equal bytes.
"""

import ctypes
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from skyherd.errors import NativeLibraryError
from skyherd.native.build import levels, library_name, sources_folder, sources_version

BUILD_COMMAND = "python src/skyherd/native/build.py"

Signature = tuple[object, ...]
"""Type of a function's result, followed by those of its arguments, as ctypes has them."""


def load(path: Path, sources: Path) -> ctypes.CDLL:
    """Load one build of a library.

    Args:
        path: of the library.
        sources: folder of its sources.

    Raises:
        NativeLibraryError: the file is missing, cannot be loaded, or has been built from other sources.
    """
    what_to_do = f"reinstall skyherd, or in a checkout run `{BUILD_COMMAND}`"
    if not path.exists():
        raise NativeLibraryError(f"{path}: the compiled library is missing; {what_to_do}")
    try:
        functions = ctypes.CDLL(str(path))
        declare(functions, {"sources_version": (ctypes.c_char_p,), "processor_level": (ctypes.c_int32,)})
        version = functions.sources_version()
    except (OSError, AttributeError) as error:
        raise NativeLibraryError(
            f"{path}: the compiled library cannot be loaded: {error}; {what_to_do}"
        ) from None
    if version.decode() != sources_version(sources):
        raise NativeLibraryError(f"{path}: the compiled library is of another version; {what_to_do}")
    return functions


@cache
def library_of(package: str) -> ctypes.CDLL:
    """Return the library of a package, `vision` or `render`, for this processor.

    Raises:
        NativeLibraryError: as `load`.
    """
    folder, lowest = sources_folder(package), levels()[0]
    first = load(folder / library_name(package, lowest), folder)
    level = int(first.processor_level())
    return first if level == lowest else load(folder / library_name(package, level), folder)


def declare(functions: ctypes.CDLL, signatures: Mapping[str, Signature]) -> None:
    """Declare the types of functions of a library, by their names."""
    for name, (result, *arguments) in signatures.items():
        function = getattr(functions, name)
        function.restype, function.argtypes = result, arguments
