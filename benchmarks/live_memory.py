"""Measure the memory growth of every process of a live run over twenty minutes.

    python benchmarks/live_memory.py --json live_memory.json
    python benchmarks/live_memory.py --minutes 5 --figure live_memory.png

`skyherd world` and `skyherd live run` run an armed lab on loopback. Every few seconds the private resident
memory of each process (`RssAnon` in /proc) is read. The first quarter of the time is left out: libraries
load, and inboxes and the tracker's memories fill. `grows` is the slope of a line through the rest, an hour,
with twice its standard error; the correlation time of residuals is assumed to be ten readings. `gained` is
the median of the last tenth minus that of the first.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from skyherd.files.atomic import write_text
from skyherd.live.lab import load_lab

READ_S = 5.0
LEFT_OUT = 0.25
LASTS = 10
MIB = 1024.0


def processes_of(folder: Path) -> dict[str, int]:
    """Return process ids by name, of all that were started with a lab file in a folder."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if not any(word.startswith(str(folder)) for word in words) or "skyherd" not in words:
            continue
        verb = words[words.index("skyherd") + 1 :]
        name = {"unit": "unit/{2}", "robot": "robot/{2}", "world": "world", "live": "supervisor"}.get(verb[0])
        if name is not None:
            found[name.format(*verb)] = int(path.parent.name)
    return found


def own_mib(process: int) -> float:
    """Return the resident memory of a process that is its own, MiB; NaN if it is gone."""
    try:
        text = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return float("nan")
    return next(
        (int(line.split()[1]) / MIB for line in text.splitlines() if line.startswith("RssAnon")), np.nan
    )


def watch(scenario: str, minutes: float, speed: float, settings: list[str]) -> dict[str, Any]:
    """Run a lab, and return the memory of its processes, MiB, over time, s."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "lab.toml"
        source = Path(sys.modules[load_lab.__module__].__file__ or "").parent / "labs" / f"{scenario}.toml"
        file.write_text(source.read_text(), encoding="utf-8")
        skyherd = [sys.executable, "-m", "skyherd"]
        duration_s = 60 * minutes * speed + 60
        world = [*skyherd, "world", scenario, "--lab", str(file), "--speed", str(speed)]
        team = [*skyherd, "live", "run", str(file), "--arm", "--out", str(folder / "run")]
        team += ["--duration", str(60 * minutes + 20)]
        team += [part for setting in settings for part in ("--set", setting)]
        with (
            subprocess.Popen([*world, "--set", f"duration_s={duration_s}"], stdout=subprocess.DEVNULL) as one,
            subprocess.Popen(team, stdout=subprocess.DEVNULL) as other,
        ):
            try:
                time.sleep(15.0)
                return _read(folder, 60 * minutes)
            finally:
                other.terminate()
                other.wait(60)
                one.terminate()


def _read(folder: Path, for_s: float) -> dict[str, Any]:
    """Return the memory of all processes, read every `READ_S` for a duration."""
    names = processes_of(folder)
    begun_s = time.monotonic()
    times_s: list[float] = []
    read: dict[str, list[float]] = {name: [] for name in sorted(names)}
    while (now_s := time.monotonic() - begun_s) < for_s:
        times_s.append(now_s)
        for name, values in read.items():
            values.append(own_mib(names[name]))
        time.sleep(READ_S)
    disk_mib = sum(path.stat().st_size for path in (folder / "run").glob("*.mcap")) / MIB**2
    return {"times_s": times_s, "mib": read, "disk_mib": disk_mib, "restarts": len(_again(folder))}


def _again(folder: Path) -> list[Path]:
    """Return the files of processes that were restarted."""
    return list((folder / "run").glob("*.*.mcap"))


def judge(watched: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the memory growth of each process, MiB."""
    times_s = np.array(watched["times_s"])
    kept = times_s >= LEFT_OUT * times_s[-1]
    rows = []
    for name, values in watched["mib"].items():
        own = np.array(values)[kept]
        hours = times_s[kept] / 3600
        tenth = max(1, own.size // 10)
        slope, error = _line(hours, own)
        rows.append(
            {
                "name": name,
                "median_mib": float(np.median(own)),
                "gained_mib": float(np.median(own[-tenth:]) - np.median(own[:tenth])),
                "grows_mib_per_hour": slope,
                "within_mib_per_hour": 2 * error,
            }
        )
    return rows


def _line(hours: np.ndarray, own: np.ndarray) -> tuple[float, float]:
    """Return the slope of the line through memory over time, and its standard error."""
    away = hours - hours.mean()
    slope = float(away @ own / (away @ away))
    left = own - own.mean() - slope * away
    return slope, float(np.sqrt(LASTS * (left @ left) / max(1, own.size - 2) / (away @ away)))


def draw(watched: dict[str, Any], path: Path) -> None:
    """Draw memory over time, a line a process."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4))
    for name, values in watched["mib"].items():
        axes.plot(np.array(watched["times_s"]) / 60, values, label=name, linewidth=1)
    axes.set(xlabel="time (minutes)", ylabel="memory of its own (MiB)", ylim=(0, None))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, ncols=2)
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Watch a lab and print the processes that grow."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--scenario", default="triangle")
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--speed", type=float, default=1.0, help="seconds of the scenario a second")
    parser.add_argument("--set", action="append", default=[], help="key=value put over the lab")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    watched = watch(options.scenario, options.minutes, options.speed, options.set)
    rows = judge(watched)
    print("| process | MiB | gained | grows, MiB an hour |\n|---|---|---|---|")
    for row in rows:
        grows = f"{row['grows_mib_per_hour']:+.1f} ± {row['within_mib_per_hour']:.1f}"
        print(f"| {row['name']} | {row['median_mib']:.1f} | {row['gained_mib']:+.2f} | {grows} |")
    print(f"recordings: {watched['disk_mib']:.1f} MiB; {watched['restarts']} restarts")
    if options.json:
        write_text(options.json, json.dumps({"watched": watched, "rows": rows}) + "\n")
    if options.figure:
        draw(watched, options.figure)


if __name__ == "__main__":
    main()
