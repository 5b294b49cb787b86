"""Measure the start-up time of the package and the command line, beside NumPy and typer.

    python benchmarks/startup.py [--rounds 15]

Each round starts every command once, in turn, so that other load affects all equally. It prints the medians
and two ratios: `import skyherd` over `import numpy` (limit 1) and `skyherd --help` over `import typer` (limit
4). The exit code is 1 if a ratio is above its limit.
"""

import argparse
import subprocess
import sys
from statistics import median
from time import perf_counter

COMMANDS = {
    "import numpy": ["-c", "import numpy"],
    "import skyherd": ["-c", "import skyherd"],
    "import typer": ["-c", "import typer"],
    "skyherd --help": ["-m", "skyherd", "--help"],
    "skyherd run --help": ["-m", "skyherd", "run", "--help"],
}
LIMITS = (("import skyherd", "import numpy", 1.0), ("skyherd --help", "import typer", 4.0))


def measure_s(arguments: list[str]) -> float:
    """Return the duration of an interpreter from start to end, s."""
    began_s = perf_counter()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return perf_counter() - began_s


def main() -> int:
    """Print medians and ratios; return 1 if a ratio is above its limit."""
    parser = argparse.ArgumentParser(description="How long the package and the command line take to start.")
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    for arguments in COMMANDS.values():
        measure_s(arguments)  # once for the disk's cache and for compiled files
    times_s: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(rounds):
        for name, arguments in COMMANDS.items():
            times_s[name].append(measure_s(arguments))
    medians_s = {name: median(times) for name, times in times_s.items()}
    for name, time_s in medians_s.items():
        print(f"{name:20s} {1000 * time_s:7.0f} ms")
    good = True
    for name, beside, most in LIMITS:
        ratio = medians_s[name] / medians_s[beside]
        good &= ratio <= most
        print(f"{name} over {beside}: {ratio:.2f}, at most {most:g}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
