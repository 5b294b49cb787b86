"""Put the tables of a run of `skyherd bench detectors` into `docs/benchmark.md`.

skyherd bench detectors --out runs/bench && python benchmarks/benchmark_doc.py runs/bench
"""

import argparse
import shutil
from pathlib import Path

from skyherd.bench.detectors.tables import make_tables
from skyherd.bench.result import read_result
from skyherd.bench.table import markdown_page

DOC = Path(__file__).parent.parent / "docs" / "benchmark.md"
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"
FIGURES = {"accuracy.png": "benchmark_accuracy.png", "times.png": "benchmark_times.png"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="output folder of `skyherd bench detectors`")
    options = parser.parse_args()
    result = read_result(options.folder)
    before, rest = DOC.read_text("utf-8").split(BEGIN)
    after = rest.split(END)[1]
    tables = markdown_page(make_tables(result), result.environment)
    DOC.write_text(f"{before}{BEGIN}\n\n{tables}\n{END}{after}", "utf-8")
    for drawn, shown in FIGURES.items():
        shutil.copyfile(options.folder / "figures" / drawn, DOC.parent / shown)
    print(f"written: {DOC}")


if __name__ == "__main__":
    main()
