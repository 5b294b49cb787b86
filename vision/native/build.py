"""Build of the compiled library. In a checkout: `python vision/native/build.py`.

The module uses only the standard library, because `setup.py` loads it before skyherd is installed.
"""

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

FOLDER = Path(__file__).parent

SOURCES = ("means.c", "quads.c", "regions.c", "search.c")
HEADERS = ("search.h",)

FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fPIC", "-Wall", "-Wextra")
"""Compiler flags. Without contraction and without errno, all builds round equally."""

COMPILERS = ("cc", "gcc", "clang")

GLIBC = "2.17"
"""Oldest glibc that a build by `ziglang` supports. Chosen: that of the manylinux2014 wheels of NumPy."""

Command = tuple[str, ...]


def sources_version() -> str:
    """Return the hash of the sources and flags, 16 hexadecimal digits."""
    digest = hashlib.sha256(" ".join(FLAGS).encode())
    for name in (*HEADERS, *SOURCES):
        digest.update((FOLDER / name).read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()[:16]


def is_x86_64() -> bool:
    """Return whether the processor is an x86-64."""
    return platform.machine().lower() in {"x86_64", "amd64"}


def levels() -> tuple[int, ...]:
    """Return the instruction set levels to build for: those of x86-64, or (0,) on other processors."""
    return (2, 3, 4) if is_x86_64() else (0,)


def library_name(level: int) -> str:
    """Return the file name of the library for a level."""
    suffix = {"win32": "dll", "darwin": "dylib"}.get(sys.platform, "so")
    return f"libskyherd_vision_v{level}.{suffix}" if level else f"libskyherd_vision.{suffix}"


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


def compile_library(target: Path, command: Sequence[str]) -> None:
    """Compile the sources into one shared library.

    Raises:
        RuntimeError: the compiler failed; the message has its last line.
    """
    # A process that has loaded the former file keeps it, because the new one replaces it by its name.
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        made = Path(folder) / target.name
        sources = [str(FOLDER / name) for name in SOURCES]
        version = f'-DSKYHERD_SOURCES="{sources_version()}"'
        libraries = [] if sys.platform == "win32" else ["-lm"]
        whole = [*command, *FLAGS, version, "-shared", "-o", str(made), *sources, *libraries]
        ended = subprocess.run(whole, capture_output=True, text=True, check=False)
        if ended.returncode:
            last = (ended.stderr.strip() or "no message").splitlines()[-1]
            raise RuntimeError(f"{' '.join(command)}: cannot compile {target.name}: {last}")
        made.replace(target)


def build(folder: Path = FOLDER) -> list[Path]:
    """Compile the libraries for all levels into a folder, and return their paths."""
    targets = {level: folder / library_name(level) for level in levels()}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        jobs = [
            pool.submit(compile_library, path, compiler_command(level)) for level, path in targets.items()
        ]
        for job in jobs:
            job.result()
    return list(targets.values())


if __name__ == "__main__":
    for path in build():
        print(path)
