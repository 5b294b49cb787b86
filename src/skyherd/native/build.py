"""Build of the compiled libraries. In a checkout: `python src/skyherd/native/build.py`.

The module uses only the standard library, because `setup.py` loads it before skyherd is installed.
"""

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

LIBRARIES = ("vision", "render")
"""Packages with C sources, each in a folder `native`; each has a library of its own."""

COMMON_SOURCES = (Path(__file__).parent / "library.c",)
"""Sources that every library has."""

FLAGS = (
    "-std=c11",
    "-O3",
    "-ffp-contract=off",
    "-fno-tree-slp-vectorize",
    "-fno-math-errno",
    "-fno-trapping-math",
    "-fPIC",
    "-Wall",
    "-Wextra",
    "-Wno-psabi",
)
"""Compiler flags. Without contraction and without errno, all builds round equally. The SLP vectorizer of
GCC 12 contracts products of complex numbers all the same (GCC bug 107647)."""

COMPILERS = ("cc", "gcc", "clang")

GLIBC = "2.17"
"""Oldest glibc that a build by `ziglang` supports. Chosen: that of the manylinux2014 wheels of NumPy."""

Command = tuple[str, ...]


def sources_folder(package: str) -> Path:
    """Return the folder `native` of a package, in the installed layout or in a checkout."""
    installed = Path(__file__).parents[1] / package / "native"
    return installed if installed.is_dir() else Path(__file__).parents[3] / package / "native"


def sources_version(folder: Path) -> str:
    """Return the hash of a folder's sources and of the flags, 16 hexadecimal digits."""
    digest = hashlib.sha256(" ".join(FLAGS).encode())
    for path in (*COMMON_SOURCES, *sorted([*folder.glob("*.h"), *folder.glob("*.c")])):
        digest.update(path.name.encode() + path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()[:16]


def is_x86_64() -> bool:
    """Return whether the processor is an x86-64."""
    return platform.machine().lower() in {"x86_64", "amd64"}


def levels() -> tuple[int, ...]:
    """Return the instruction set levels to build for: those of x86-64, or (0,) on other processors."""
    return (2, 3, 4) if is_x86_64() else (0,)


def library_name(package: str, level: int) -> str:
    """Return the file name of a package's library for a level."""
    suffix = {"win32": "dll", "darwin": "dylib"}.get(sys.platform, "so")
    return f"libskyherd_{package}_v{level}.{suffix}" if level else f"libskyherd_{package}.{suffix}"


def system_compiler() -> str | None:
    """Return the path of the first of `COMPILERS` on the path, or None."""
    return next((path for path in map(shutil.which, COMPILERS) if path), None)


def compiler_command(level: int) -> Command:
    """Return the compiler and its options for a level: the system's compiler, or that of `ziglang`."""
    compiler = system_compiler()
    if compiler:
        return (compiler, f"-march=x86-64-v{level}") if level else (compiler,)
    options = [f"-mcpu=x86_64_v{level}"] if level else []
    if platform.libc_ver()[0] == "glibc":
        options += ["-target", f"{platform.machine()}-linux-gnu.{GLIBC}"]
    return (sys.executable, "-m", "ziglang", "cc", *options)


def compile_library(folder: Path, target: Path, command: Command, options: Command = ()) -> None:
    """Compile the sources in a folder into one shared library, with further options.

    Raises:
        RuntimeError: the compiler failed; the message has its last line.
    """
    # A process that has loaded the former file keeps it, because the new one replaces it by its name.
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as made_folder:
        made = Path(made_folder) / target.name
        sources = [str(path) for path in (*COMMON_SOURCES, *sorted(folder.glob("*.c")))]
        version = f'-DSKYHERD_SOURCES="{sources_version(folder)}"'
        libraries = [] if sys.platform == "win32" else ["-lm"]
        whole = [*command, *FLAGS, *options, version, "-shared", "-o", str(made), *sources, *libraries]
        ended = subprocess.run(whole, capture_output=True, text=True, check=False)
        if ended.returncode:
            last = (ended.stderr.strip() or "no message").splitlines()[-1]
            raise RuntimeError(f"{' '.join(command)}: cannot compile {target.name}: {last}")
        made.replace(target)


def build(into: Path | None = None) -> list[Path]:
    """Compile all libraries for all levels, and return their paths.

    Args:
        into: folder of the package skyherd, of which each library is put into the folder `native` of its
            package; beside the sources if left out.
    """
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = {}
        for package, level in product(LIBRARIES, levels()):
            folder = sources_folder(package)
            target = (into / package / "native" if into else folder) / library_name(package, level)
            jobs[target] = pool.submit(compile_library, folder, target, compiler_command(level))
        for job in jobs.values():
            job.result()
    return list(jobs)


if __name__ == "__main__":
    for path in build():
        print(path)
