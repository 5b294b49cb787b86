"""Settings of the test run, and helpers common to several test files, as fixtures.

The fixtures are session-scoped where they can be: hypothesis may then use them too.
"""

import gc

# Objects that exist before the first test are never released, and garbage collection among them takes a third
# of the collection time.
gc.disable()

import importlib.util
import os
import re
import secrets
import shutil
import signal
import tomllib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

# pytest-xdist keeps all cores busy, so that more threads of linear algebra do not help. Results also become
# independent of the number of cores. This must be set before NumPy is imported.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import cv2
import hypothesis
import numpy as np
import pytest
import typer.main
from hypothesis.internal.conjecture import providers

from skyherd.datasets import Mission, load_mission, scenario_text
from skyherd.loop import Step, run_steps
from skyherd.markers.dictionary import QUIET_ZONE_CELLS, cells_per_side, corners_of_pose, marker_cells
from skyherd.messages import Detections, MotionGoals, UnitReport
from skyherd.render import ground

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

GARBAGE_LOOKED_FOR = 20_000
"""Threshold of garbage collection, objects. Chosen: with Python's 700 it takes 3 % of the time, since steps
and figures are many objects; 20 000 of them take some megabytes."""

# What a shell starts in the background ignores SIGINT, and so would every process that the tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

hypothesis.settings.register_profile("same", derandomize=True, deadline=None, database=None)
hypothesis.settings.register_profile("random", deadline=None, database=None, print_blob=True)


def pytest_configure(config: pytest.Config) -> None:
    """Fix the examples of property tests; with `-m random`, draw others from a printed seed."""
    # Hypothesis also draws constants of the loaded modules, so that examples would depend on earlier tests in
    # the same process.
    if hasattr(providers, "_get_local_constants"):
        providers._get_local_constants = lambda: providers._local_constants
    if not re.search(r"(?<!not )\brandom\b", config.option.markexpr):
        hypothesis.settings.load_profile("same")
        return
    hypothesis.settings.load_profile("random")
    seed = config.getoption("--hypothesis-seed")
    if seed is None:  # workers of pytest-xdist inherit the environment
        seed = os.environ.setdefault("SKYHERD_RANDOM_TESTS_SEED", str(secrets.randbits(32)))
        hypothesis.core.global_force_seed = int(seed)
    config.stash[SEED] = str(seed)


SEED = pytest.StashKey[str]()
"""Key of the seed of random property tests."""


def pytest_report_header(config: pytest.Config) -> str | None:
    """Return how to repeat a run of random property tests."""
    seed = config.stash.get(SEED, None)
    return seed and f"random property tests, seed {seed}: repeat with -m random --hypothesis-seed={seed}"


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every property test as a random test; a slow case of a smoke test is not a smoke test."""
    for item in items:
        if item.get_closest_marker("slow"):
            item.own_markers[:] = [mark for mark in item.own_markers if mark.name != "smoke"]
        if hypothesis.is_hypothesis_test(getattr(item, "obj", None)):
            item.add_marker("random")


def pytest_collection_finish() -> None:
    """Enable garbage collection, except among existing objects."""
    gc.freeze()
    gc.set_threshold(GARBAGE_LOOKED_FOR)
    gc.enable()


@pytest.fixture(scope="session")
def load_benchmark() -> Iterator[Callable[[str], ModuleType]]:
    """Provide a function that loads a script of `benchmarks/` as a module, with its neighbours importable."""

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(f"benchmark_{name}", BENCHMARKS / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        yield load


@pytest.fixture(scope="session")
def scenario_tree() -> Callable[[str], dict[str, Any]]:
    """Return a fresh tree of a built-in scenario, to be changed at will."""

    def make(name: str) -> dict[str, Any]:
        return tomllib.loads(scenario_text(name))

    return make


@pytest.fixture(scope="session")
def ideal_triangle() -> list[Step]:
    """Return 80 s of the mission `triangle` on exact points. Tests must not change it.

    Nothing is rectified: an ideal camera's detections pass unchanged, as the rectifier's tests show.
    """
    settings = ["perception=ideal", "duration_s=80", "control.rectify=false"]
    return list(run_steps(load_mission("triangle", settings)))


@pytest.fixture(scope="session")
def ideal_failure() -> tuple[Mission, list[Step]]:
    """Return the mission `failure` until a while after unit 0's death, on exact points. Do not change it."""
    mission = load_mission("failure", ["perception=ideal", "duration_s=32.0", "control.rectify=false"])
    return mission, list(run_steps(mission))


GROUNDS_KEPT = 12
"""Number of grounds at one resolution that are kept. Chosen: some ten megabytes each at most."""


@pytest.fixture(scope="session", autouse=True)
def grounds_made_once() -> Iterator[None]:
    """Keep more grounds than usual in memory, at the resolutions in use: making one takes long."""
    spectrum_of = lru_cache(8)(ground._concrete_spectrum.__wrapped__)
    make, kept = ground._band_limited, OrderedDict[tuple[int, int, float], tuple[np.ndarray, np.ndarray]]()

    def band_limited(spectrum: np.ndarray, samples: int, sigma: float) -> np.ndarray:
        key = id(spectrum), samples, sigma
        if key not in kept:
            kept[key] = spectrum, make(spectrum, samples, sigma)  # no other gets its id while it is kept
        kept.move_to_end(key)
        if len(kept) > GROUNDS_KEPT:
            kept.popitem(last=False)
        return kept[key][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ground, "_concrete_spectrum", spectrum_of)
        patch.setattr(ground, "_band_limited", band_limited)
        yield


@pytest.fixture(scope="session", autouse=True)
def commands_made_once() -> Iterator[None]:
    """Build the command line from its functions once, instead of at each of hundreds of calls."""
    make = typer.main.get_command

    @lru_cache(8)
    def made(app: typer.Typer, _environment: str | None) -> Any:
        return make(app)

    def get_command(app: typer.Typer) -> Any:
        return made(app, os.environ.get("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", get_command)
        yield


COARSE_DPI = 65
"""Resolution of figures in tests, pixels an inch. Chosen: half of the true one; text is laid out as well."""


@pytest.fixture(scope="session", autouse=True)
def coarse_figures() -> Iterator[None]:
    """Reduce the pixels of figures: only the tests of figures depend on them."""
    with pytest.MonkeyPatch.context() as patch:
        for module in ("skyherd.plots.style", "skyherd.plots.panels", "skyherd.study.figures"):
            patch.setattr(f"{module}.DPI", COARSE_DPI)
        yield


@pytest.fixture(scope="session")
def reference_fit() -> Callable[[np.ndarray, np.ndarray], tuple[complex, complex]]:
    """Return the least-squares similarity `z -> a z + b` from a real system in 4 unknowns."""

    def fit(template: np.ndarray, current: np.ndarray) -> tuple[complex, complex]:
        x, y = template.real, template.imag
        one, zero = np.ones_like(x), np.zeros_like(x)
        rows = np.vstack([np.column_stack([x, -y, one, zero]), np.column_stack([y, x, zero, one])])
        s_cos, s_sin, t_x, t_y = np.linalg.lstsq(
            rows, np.concatenate([current.real, current.imag]), rcond=None
        )[0]
        return complex(s_cos, s_sin), complex(t_x, t_y)

    return fit


@pytest.fixture(scope="session")
def make_detections() -> Callable[..., Detections]:
    """Return detections at image points `u + iv`, with default values for everything else."""

    def make(
        ids: Any,
        points: Any,
        *,
        headings: Any = None,
        sides: Any = None,
        size=(800, 800),
        unit_id=0,
        time_s=0.0,
    ) -> Detections:
        points = np.asarray(points, dtype=complex)
        headings = np.zeros(points.size) if headings is None else np.asarray(headings, dtype=float)
        sides = np.full(points.size, 20.0) if sides is None else np.asarray(sides, dtype=float)
        centers = np.column_stack([points.real, points.imag])
        return Detections(
            unit_id=unit_id,
            time_s=time_s,
            image_size_px=np.array(size),
            ids=np.asarray(ids),
            centers_px=centers,
            headings_rad=headings,
            sides_px=sides,
            corners_px=corners_of_pose(centers, headings, sides),
            covariances=np.zeros((points.size, 3, 3)),
        )

    return make


@pytest.fixture(scope="session")
def make_report() -> Callable[..., UnitReport]:
    """Return a unit's report, from the robots it sees at image points `u + iv`."""

    def make(
        unit_id: int, ids: Any, points: Any, controlled: Any, secure: Any = (), size=(800, 800)
    ) -> UnitReport:
        points = np.asarray(points, dtype=complex)
        return UnitReport(
            unit_id=unit_id,
            time_s=0.0,
            image_size_px=np.array(size),
            ids=np.asarray(ids),
            points_px=np.column_stack([points.real, points.imag]),
            controlled_ids=np.asarray(controlled),
            secure_ids=np.asarray(secure, dtype=np.int64),
        )

    return make


@pytest.fixture(scope="session")
def make_goals() -> Callable[..., MotionGoals]:
    """Return goals from vectors in the robots' frames, `rho e^{i bearing}`, and distances by neighbour."""

    def make(
        unit_id: int, ids: Any, rho: Any, *, sides: Any = None, neighbors: Any = None, time_s: float = 0.0
    ) -> MotionGoals:
        rho = np.asarray(rho, dtype=complex)
        near = neighbors or [{} for _ in rho]
        width = max(len(row) for row in near)
        told = np.full((rho.size, width), -1)
        distances = np.zeros((rho.size, width))
        for row, pairs in enumerate(near):
            told[row, : len(pairs)] = list(pairs)
            distances[row, : len(pairs)] = list(pairs.values())
        return MotionGoals(
            unit_id=unit_id,
            time_s=time_s,
            ids=np.asarray(ids),
            rho_px=np.abs(rho),
            bearings_rad=np.angle(rho),
            sides_px=np.full(rho.size, 20.0) if sides is None else np.asarray(sides, dtype=float),
            neighbor_ids=told,
            neighbor_distances_px=distances,
        )

    return make


BROWSER_ARGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]

OVERFLOWING = """() => {
  const scrolls = e => e && (['auto', 'scroll', 'hidden'].includes(getComputedStyle(e).overflowX)
                             || scrolls(e.parentElement));
  return [...document.body.querySelectorAll('*')]
    .filter(e => e.getBoundingClientRect().right > innerWidth + 0.5 && !scrolls(e.parentElement))
    .map(e => e.outerHTML.slice(0, 80));
}"""


UNCOMFORTABLE = """least => {
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
  while (texts.nextNode()) {
    const e = texts.currentNode.parentElement;
    if (texts.currentNode.data.trim() && e.checkVisibility() && parseFloat(getComputedStyle(e).fontSize) < 14)
      found.push("text " + texts.currentNode.data.trim().slice(0, 40));
  }
  for (const e of document.querySelectorAll("button, summary, input, [role=tab]"))
    if (e.checkVisibility() && e.offsetHeight && e.offsetHeight < least)
      found.push(e.outerHTML.slice(0, 80) + " " + e.offsetHeight);
  return found;
}"""


def missing(what: str) -> None:
    """Skip without a browser, or fail where one is required."""
    reason = f"{what} is not installed"
    if os.environ.get("SKYHERD_REQUIRE_BROWSER") == "1":
        pytest.fail(f"{reason}, and SKYHERD_REQUIRE_BROWSER=1 asks for it")
    pytest.skip(reason)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Provide headless Chromium; skip the test without it."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("playwright")
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        missing("chromium (or google-chrome)")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=BROWSER_ARGS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="session")
def assert_nothing_overflows() -> Callable[[Any], None]:
    """Assert that neither a page nor an element of it is wider than its window, unless it scrolls."""

    def check(window: Any) -> None:
        assert window.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert window.evaluate(OVERFLOWING) == []

    return check


@pytest.fixture(scope="session")
def assert_comfortable(assert_nothing_overflows) -> Callable[..., None]:
    """Assert that a page does not overflow, has text of at least 14 px, and controls of a least height."""

    def check(window: Any, control_px: int = 44) -> None:
        assert_nothing_overflows(window)
        assert window.evaluate(UNCOMFORTABLE, control_px) == []

    return check


@pytest.fixture(scope="session")
def place_markers() -> Callable[..., np.ndarray]:
    """Return similarities (N, 3, 3) from a marker's plane (right, down, in sides) to pixels."""

    def place(centers: Any, headings: Any, sides: Any) -> np.ndarray:
        centers, headings = np.atleast_1d(np.asarray(centers, complex)), np.asarray(headings, dtype=float)
        arms = np.broadcast_to(1j * np.asarray(sides) * np.exp(1j * headings), centers.shape)
        rows = np.zeros((centers.size, 3, 3))
        rows[:, 0] = np.column_stack([arms.real, -arms.imag, centers.real])
        rows[:, 1] = np.column_stack([arms.imag, arms.real, centers.imag])
        rows[:, 2, 2] = 1.0
        return rows

    return place


@pytest.fixture(scope="session")
def draw_markers() -> Callable[..., np.ndarray]:
    """Draw markers by brute force with 16 points a pixel, independent of `skyherd.render`.

    The points are a lattice in which no two share a line or column: upright edges lie right to 1/32 px.
    `paint`, if any, changes the float image before lens and sensor: what covers markers, or clutter.
    """

    def card(image: np.ndarray, dictionary: str, marker_id: int, matrix: np.ndarray) -> None:
        n = cells_per_side(dictionary)
        half = 0.5 + QUIET_ZONE_CELLS / n
        corners = (
            np.array([[-half, -half, 1], [half, -half, 1], [half, half, 1], [-half, half, 1]]) @ matrix.T
        )
        corners = corners[:, :2] / corners[:, 2:]
        left, top = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
        right, bottom = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, image.shape[::-1])
        if right <= left or bottom <= top:
            return
        (a, b, c), (d, e, f), (g, h, i) = np.linalg.inv(matrix)
        cells = np.pad(marker_cells(dictionary, marker_id), 1, constant_values=True)

        def cell_at(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Return row and column of the card's cells, or beyond them, at points of the image."""
            w = g * u + h * v + i
            x, y = (a * u + b * v + c) / w, (d * u + e * v + f) / w
            return np.floor((y + 0.5) * n).astype(int) + 1, np.floor((x + 0.5) * n).astype(int) + 1

        def grey_at(row: np.ndarray, column: np.ndarray, behind: np.ndarray) -> np.ndarray:
            inside = (row >= 0) & (row < n + 2) & (column >= 0) & (column < n + 2)
            white = cells[row.clip(0, n + 1), column.clip(0, n + 1)]
            return np.where(inside, np.where(white, 230.0, 30.0), behind)

        # Cells are convex: a pixel whose corners all lie in one cell lies in it, and needs no points.
        region = image[top:bottom, left:right]
        row, column = cell_at(np.arange(left, right + 1) - 0.5, np.arange(top, bottom + 1)[:, None] - 0.5)
        whole = np.ones(region.shape, dtype=bool)
        for index in (row, column):
            for other in (index[1:, :-1], index[:-1, 1:], index[1:, 1:]):
                whole &= other == index[:-1, :-1]
        v, u = np.nonzero(~whole)
        k = np.arange(16)[:, None]
        points = cell_at(left + u + (k + 0.5) / 16 - 0.5, top + v + (5 * k % 16 + 0.5) / 16 - 0.5)
        mixed = grey_at(*points, region[v, u]).mean(axis=0)
        region[...] = grey_at(row[:-1, :-1], column[:-1, :-1], region)
        region[v, u] = mixed

    def draw(
        matrices: np.ndarray,
        ids: Any,
        size_px: tuple[int, int],
        rng: np.random.Generator,
        *,
        dictionary: str = "4X4_50",
        noise: float = 5.0,
        psf_px: float = 0.8,
        texture: float = 8.0,
        paint: Callable[[np.ndarray], None] | None = None,
    ) -> np.ndarray:
        width, height = size_px
        image = np.full((height, width), 128.0, np.float32)
        if texture:
            coarse = rng.normal(0, texture, (height // 6 + 2, width // 6 + 2)).astype(np.float32)
            image += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        for marker_id, matrix in zip(ids, matrices, strict=True):
            card(image, dictionary, int(marker_id), matrix)
        if paint is not None:
            paint(image)
        if psf_px:
            image = cv2.GaussianBlur(image, (0, 0), psf_px)
        image += noise * rng.standard_normal(image.shape, dtype=np.float32)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    return draw


@pytest.fixture
def write_study(tmp_path: Path) -> Callable[..., Path]:
    """Write a study file, a small one by default."""
    from study_runs import SMALL

    def make(text: str = SMALL, name: str = "small.toml") -> Path:
        path = tmp_path / name
        path.write_text(text, "utf-8")
        return path

    return make


@pytest.fixture
def without_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run studies in this process, one run at a time."""
    from study_runs import run_in_process

    run_in_process(monkeypatch)
