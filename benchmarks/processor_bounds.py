"""Time of the compiled fit and search against what the processor allows: arithmetic and bandwidth.

    OPENBLAS_NUM_THREADS=1 python benchmarks/processor_bounds.py [--json FILE] [--figure FILE]

Operations and bytes of a pixel are counted in the sources. Their least time follows from two rates of one
core, which are measured. One is the arithmetic of a product of large matrices in single precision. The fit
has half of it, since it multiplies and adds in two instructions so that all builds give equal bytes. The
other is the bandwidth of a copy as large as the part's memory. Times are minima over many calls.

*Columns* and *products* are the two halves of a step of the fit, for markers of 10 to 144 px. *Followed
frame* is its compiled call with 16 markers of 30 px in 1280x960, each of which takes a step at least.
*Search* is `find_quads` of such an image.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from image_cost import DICTIONARY, NOISE, SIDE_PX, WARM_UP, Scene
from photograph_stages import Stopwatch

sys.path.append(str(Path(__file__).parents[1]))

from tests.helpers.design_matrix_reference import blur_tables, marker_records
from tests.helpers.fit_stages import BLOCK_PX, stages

from skyherd.drawing.palette import INK, MUTED, UNIT_COLORS
from skyherd.geometry import Image
from skyherd.jobs.helpers import one_thread
from skyherd.plots.style import drawing_style, new_figure
from skyherd.render import Sensor
from skyherd.vision.native.library import Library
from skyherd.vision.photometric.detector import DeferringDetector
from skyherd.vision.photometric.fitting.appearance import appearances_of
from skyherd.vision.photometric.fitting.local_homography import LocalHomographies
from skyherd.vision.photometric.fitting.plane import Plane
from skyherd.vision.search.quads import find_quads

FIGURE = Path(__file__).parents[1] / "docs" / "processor_bounds.png"
SIDES_PX, BLUR_PX = (10, 20, 30, 60, 144), 0.8
SIZE_PX, MARKERS, FRAMES = (1280, 960), 16, 60
CALLS, PIXELS_AT_ONCE = 100, 40_000

COPIED_BYTES = tuple(2**power for power in range(14, 29))
"""Sizes of the copies, bytes. Chosen: from half of a first cache to beyond usual last ones."""

EDGE, ROW, SUMS, GROUND, LEVEL, WRITTEN = 53, 26, 15, 115, 26, 42
"""Operations of a pixel in `round_blur.c` and `columns.h`. The first three are for an edge of cells along an
axis (`bell`, `step`), two edges in a row of cells, and the sums over an edge of rows. The others are for the
ground, the level with its derivatives, and the columns. A multiplication with an addition counts as two."""

ELLIPTIC_EDGE, ELLIPTIC_ROW, ELLIPTIC_SUMS, ELLIPTIC_LEVEL = 60, 34, 35, 90
"""The same in `elliptic_blur.c`, with derivatives of up to four orders."""

PRODUCTS = 16 * 17
"""Operations of a pixel for the products of 16 columns, each pair once."""

COLUMN_BYTES, PRODUCT_BYTES = 81, 64
"""Bytes of a pixel: read place, column, line and grey level, and written columns; read columns."""

THRESHOLD, SEARCHED = 70, 1 + 1 / 4 + 1 / 16
"""Operations of a pixel for its threshold (`means.c`: four window sums, sharpening, two comparisons) in 16
bits, and pixels of the three image sizes over those of the image. Numbers of 16 bits have twice as many
lanes, so that they reach the rate of the product of matrices with one operation an instruction."""

SEARCH_BYTES = 2.5
"""Bytes of a pixel that a search reads and writes: grey levels, smaller images and masks."""


SUMMED = "operations", "bytes_moved", "arithmetic_ns", "memory_ns"
"""Attributes of a part that both halves of a step add up to."""


@dataclass(frozen=True)
class Part:
    """Time of a part for a pixel.

    Attributes:
        name: what it is.
        side_px: side of the marker, px, or None.
        operations: of a pixel.
        bytes_moved: of a pixel.
        took_ns: measured time of a pixel, ns.
        arithmetic_ns: least time of its operations.
        memory_ns: least time of its bytes.
    """

    name: str
    side_px: int | None
    operations: float
    bytes_moved: float
    took_ns: float
    arithmetic_ns: float
    memory_ns: float

    @property
    def share(self) -> float:
        """Least time over the measured one."""
        return max(self.arithmetic_ns, self.memory_ns) / self.took_ns


def least_s(call: Callable[[], object], calls: int = CALLS) -> float:
    """Return the minimum duration of a call, s."""
    times_s = []
    for _ in range(calls):
        began_s = perf_counter()
        call()
        times_s.append(perf_counter() - began_s)
    return min(times_s)


@dataclass(frozen=True)
class Processor:
    """Rates of one core.

    Attributes:
        operations_per_ns: of a product of matrices in single precision.
        bytes_per_ns: read and written by a copy, by its size in bytes.
    """

    operations_per_ns: float
    bytes_per_ns: dict[int, float]

    @classmethod
    def measured(cls) -> "Processor":
        """Measure this machine's."""
        side = 768
        one = np.random.default_rng(0).standard_normal((side, side), dtype=np.float32)
        made = np.empty_like(one)
        product_s = least_s(lambda: np.matmul(one, one, out=made), 20)
        rates = {}
        for size in COPIED_BYTES:
            source = np.zeros(size // 2, dtype=np.uint8)
            target = np.ones_like(source)
            rates[size] = size / least_s(lambda source=source, target=target: np.copyto(target, source)) / 1e9
        return cls(2 * side**3 / product_s / 1e9, rates)

    @property
    def separate_per_ns(self) -> float:
        """Operations per ns if multiplications and additions are separate."""
        return self.operations_per_ns / 2

    def memory_ns(self, bytes_moved: float, size: float) -> float:
        """Return the least time of some bytes within memory of a size, bytes."""
        nearest = min(self.bytes_per_ns, key=lambda copied: abs(np.log(copied / size)))
        return bytes_moved / self.bytes_per_ns[nearest]


def fit_parts(processor: Processor, side_px: int) -> list[Part]:
    """Return both halves of a step of the fit of markers, under round and elliptic blur."""
    square_px = side_px / 2 * np.array([[[-0.9, -1.0], [1.0, -0.8], [0.95, 1.0], [-1.0, 0.9]]]) + side_px
    count = max(1, PIXELS_AT_ONCE // side_px**2)
    shapes = LocalHomographies.of_corners(np.repeat(square_px, count, axis=0))
    looks = appearances_of(DICTIONARY, np.zeros(count, dtype=int), shapes.blurs(BLUR_PX), Plane(), NOISE)
    image, markers = np.full((2 * side_px, 2 * side_px), 128, dtype=np.uint8), marker_records(shapes, looks)
    blocks = stages().list_pixels(markers, image.shape)
    pixels, about = int(blocks.counts.sum()), (looks.cells, looks.texture, blocks)
    bends = np.empty((len(blocks.columns), 3, BLOCK_PX), dtype=np.float32)
    tables = blur_tables(shapes, markers["sigma"], 0j)
    edges = 2 * int(np.ceil(5 * BLUR_PX / side_px * (looks.cells.shape[1] - 2)))
    rest = GROUND * bool(looks.reaches_ground[0]) + WRITTEN
    round_operations = operations_of(edges, EDGE, ROW, SUMS) + LEVEL + rest
    elliptic_operations = (
        operations_of(edges, ELLIPTIC_EDGE, ELLIPTIC_ROW, ELLIPTIC_SUMS) + ELLIPTIC_LEVEL + rest
    )

    def part(name: str, operations: float, bytes_moved: float, call: Callable[[], object]) -> Part:
        arithmetic_ns = operations / processor.separate_per_ns
        memory_ns = processor.memory_ns(bytes_moved, bytes_moved * pixels / count)
        took_ns = 1e9 * least_s(call) / pixels
        return Part(name, side_px, operations, bytes_moved, took_ns, arithmetic_ns, memory_ns)

    return [
        part(
            "columns, round blur",
            round_operations,
            COLUMN_BYTES,
            lambda: stages().fill_round(image, markers, *about),
        ),
        part(
            "columns, elliptic blur",
            elliptic_operations,
            COLUMN_BYTES + 12,
            lambda: stages().fill_elliptic(image, markers, tables, *about, bends),
        ),
        part("products", PRODUCTS, PRODUCT_BYTES, lambda: stages().gram_matrices(blocks)),
    ]


def operations_of(edges: int, edge: int, row: int, sums: int) -> float:
    """Return the operations of a pixel for so many edges along either axis; `row` is for two of them."""
    return 2 * edges * edge + (edges + 1) * edges / 2 * row + edges * sums


def followed_part(step: list[Part]) -> Part:
    """Return the compiled call of a followed frame; `step` are both halves of a step of its markers."""
    scene = Scene(DICTIONARY, SIZE_PX, MARKERS)
    scene.renderer.sensor = Sensor(NOISE, np.random.default_rng(2))
    detector, calls_s = DeferringDetector(DICTIONARY), []
    for frame in range(WARM_UP + FRAMES):
        with Stopwatch({"call": [(Library, "follow_markers")]}) as watch:
            found = detector.detect(scene.draw(frame), time_s=frame / 10)
        calls_s.append(watch.spent_s["call"])
    shapes = LocalHomographies.of_corners(found.corners_px)
    looks = appearances_of(DICTIONARY, found.ids, shapes.blurs(BLUR_PX), Plane(), NOISE)
    pixels = stages().list_pixels(marker_records(shapes, looks), SIZE_PX[::-1]).counts.sum()
    took_ns = 1e9 * float(np.median(calls_s[WARM_UP:])) / pixels
    sums = {name: sum(getattr(part, name) for part in step) for name in SUMMED}
    return Part("followed frame", SIDE_PX, took_ns=took_ns, **sums)


def search_part(processor: Processor, image: Image, name: str) -> Part:
    """Return the search of an image."""
    took_ns = 1e9 * least_s(lambda: find_quads(image), 30) / image.size
    operations, memory_ns = SEARCHED * THRESHOLD, processor.memory_ns(SEARCH_BYTES, SEARCH_BYTES * image.size)
    return Part(
        name, None, operations, SEARCH_BYTES, took_ns, operations / processor.operations_per_ns, memory_ns
    )


def measure() -> tuple[Processor, list[Part]]:
    """Return the rates of the processor, and all parts."""
    processor, parts = Processor.measured(), []
    for side_px in SIDES_PX:
        parts += fit_parts(processor, side_px)
    of_step = [part for part in parts if part.side_px == SIDE_PX and "elliptic" not in part.name]
    parts.append(followed_part(of_step))
    scene = Scene(DICTIONARY, SIZE_PX, MARKERS)
    for noise in (0.0, NOISE):
        scene.renderer.sensor = Sensor(noise, np.random.default_rng(2))
        parts.append(search_part(processor, scene.draw(0), f"search, noise {noise:g}"))
    return processor, parts


def draw(processor: Processor, parts: list[Part], path: Path) -> None:
    """Draw operations per ns over operations per byte, and least times beside measured ones."""
    with drawing_style():
        figure = new_figure(4.2)
        left, right = figure.subplots(1, 2)
        at = np.geomspace(0.8, 60, 200)
        cache, memory = (processor.bytes_per_ns[COPIED_BYTES[place]] for place in (5, -1))
        for rate, style, name in (
            (cache, "-", "limit within the cache"),
            (memory, "--", "limit of main memory"),
        ):
            left.plot(at, np.minimum(at * rate, processor.separate_per_ns), style, color=MUTED, label=name)
        names = list(dict.fromkeys(part.name for part in parts if part.side_px))
        for name, mark, color in zip(names, "osDP", (INK, *UNIT_COLORS), strict=False):
            rows = [part for part in parts if part.name == name]
            x, y = zip(*[(r.operations / r.bytes_moved, r.operations / r.took_ns) for r in rows], strict=True)
            left.plot(x, y, mark, color=color, ms=5, label=name)
        left.set(xscale="log", yscale="log", ylim=(2.5, 110))
        left.set(xlabel="operations per byte", ylabel="operations per ns, one core")
        left.set_xticks((1, 2, 5, 10, 20, 50), ("1", "2", "5", "10", "20", "50"))
        left.set_yticks((5, 10, 20, 40, 80), ("5", "10", "20", "40", "80"))
        left.minorticks_off()
        left.legend(loc="lower right", fontsize=8)
        shown = [part for part in parts if part.side_px in (None, SIDE_PX)][::-1]
        places = np.arange(len(shown))
        least_ns = [max(part.arithmetic_ns, part.memory_ns) for part in shown]
        right.barh(
            places + 0.2, [part.took_ns for part in shown], 0.36, color=UNIT_COLORS[0], label="measured"
        )
        right.barh(places - 0.2, least_ns, 0.36, color=MUTED, label="least")
        right.set_yticks(places, [part.name for part in shown], fontsize=8)
        right.set_xlabel("ns a pixel")
        right.legend(loc="lower right")
        figure.savefig(path)


def main() -> None:
    """Measure, print a table, and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="file for all values")
    parser.add_argument("--figure", type=Path, default=FIGURE)
    options = parser.parse_args()
    with one_thread():
        processor, parts = measure()
    print(f"{processor.operations_per_ns:.0f} operations per ns; bytes per ns of copies:", end=" ")
    print(", ".join(f"{size / 1024:g} KiB {rate:.0f}" for size, rate in processor.bytes_per_ns.items()))
    print("\n| part | marker, px | operations | bytes | measured, ns | arithmetic, ns | memory, ns | share |")
    print("|---|---|---|---|---|---|---|---|")
    for part in parts:
        numbers = part.took_ns, part.arithmetic_ns, part.memory_ns, part.share
        told = " | ".join(f"{number:.2f}" for number in numbers)
        counts = f"{part.operations:.0f} | {part.bytes_moved:g}"
        print(f"| {part.name} | {part.side_px or ''} | {counts} | {told} |")
    if options.json:
        values = {"processor": asdict(processor), "parts": [asdict(part) for part in parts]}
        options.json.write_text(json.dumps(values, indent=1) + "\n")
    draw(processor, parts, options.figure)


if __name__ == "__main__":
    main()
