"""Compare the duration of README's test run in two commits.

    python benchmarks/suite_time.py 85a37f7 HEAD [--rounds 1] [--workers 2]

Each commit is cloned into a folder of its own and installed by README's test command, which is not measured.
Then the tests run in turn, so that other load and heat affect both equally. It prints wall time and processor
time of each run (user and system, of all processes), and the ratios of the sums. Other load affects the wall
time much more than the processor time.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).parents[1]


def install(commit: str, folder: Path) -> Path:
    """Clone a commit, install it with its test requirements, and return the path of its pytest."""
    subprocess.run(["git", "clone", "-q", ROOT, folder], check=True)
    subprocess.run(["git", "checkout", "-q", commit], cwd=folder, check=True)
    subprocess.run([sys.executable, "-m", "venv", ".venv-test"], cwd=folder, check=True)
    subprocess.run([".venv-test/bin/pip", "install", "-q", ".[test]"], cwd=folder, check=True)
    return folder / ".venv-test" / "bin" / "pytest"


def measure_s(pytest: Path, folder: Path, workers: int) -> tuple[float, float, str]:
    """Return wall and processor time of a test run, s, and its last line, also if tests fail."""
    before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    ended = subprocess.run(
        [pytest, "-q", "-n", str(workers)], cwd=folder, check=False, capture_output=True, text=True
    )
    wall_s, after = perf_counter() - began_s, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return wall_s, cpu_s, (ended.stdout.splitlines() or [ended.stderr])[-1]


def main() -> None:
    """Print the times of each run and the ratios."""
    parser = argparse.ArgumentParser(description="How long the tests take in one commit beside another.")
    parser.add_argument("before", help="a commit")
    parser.add_argument("after", help="another")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    commits = (options.before, options.after)
    sums_s = [[0.0, 0.0], [0.0, 0.0]]
    with tempfile.TemporaryDirectory() as work:
        folders = [Path(work) / name for name in ("before", "after")]
        programs = [install(commit, folder) for commit, folder in zip(commits, folders, strict=True)]
        for _ in range(options.rounds):
            for index, commit in enumerate(commits):
                wall_s, cpu_s, said = measure_s(programs[index], folders[index], options.workers)
                sums_s[index][0] += wall_s
                sums_s[index][1] += cpu_s
                print(f"{commit:10s} wall {wall_s:7.1f} s, processor {cpu_s:7.1f} s: {said}", flush=True)
    wall, cpu = (after / before for before, after in zip(*sums_s, strict=True))
    print(f"{commits[1]} over {commits[0]}: wall {wall:.2f}, processor {cpu:.2f}")


if __name__ == "__main__":
    main()
