"""Scenarios: reading from TOML, validation, and completion into missions with a template and a start."""

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skyherd.control import Schedule, Template
from skyherd.datasets.configuration.bodies import Bodies
from skyherd.datasets.configuration.camera_models import CameraModel
from skyherd.datasets.configuration.file_kinds import SCENARIO, read_source, source_text
from skyherd.datasets.configuration.intervention_models import (
    CoverIntervention,
    Intervention,
    RobotIntervention,
    TemplateIntervention,
)
from skyherd.datasets.configuration.marker_layout import make_layout
from skyherd.datasets.configuration.models import Scenario
from skyherd.datasets.configuration.obstacles import check_obstacles
from skyherd.datasets.configuration.robot_models import RobotsModel
from skyherd.datasets.configuration.start import (
    coincident,
    start_headings,
    start_positions,
    with_assigned_roles,
)
from skyherd.datasets.configuration.template_image import read_template_image
from skyherd.datasets.configuration.template_models import ShapeModel
from skyherd.datasets.configuration.toml_files import apply_settings, built_in_names
from skyherd.datasets.configuration.validation import MAX_SHOWN, check_tree, locate
from skyherd.datasets.random_streams import RunStream, generator
from skyherd.datasets.shapes.shapes import shape_outline, shape_points
from skyherd.errors import DegenerateSetError, InputError, ProblemCollector, join_errors
from skyherd.files.images import Grey, read_grey
from skyherd.geometry import Array, ComplexArray, IntArray, to_complex, to_points
from skyherd.markers.dictionary import dictionary_size
from skyherd.markers.layout import MarkerLayout
from skyherd.messages import TIME_TOLERANCE_S
from skyherd.messages.checks import check_kind
from skyherd.render import Camera
from skyherd.text import shorten
from skyherd.vision import check_detector_name, load_accuracy

SAME_POINT = 1e-9
"""Distance below which two points of a template coincide, as a share of its extent. Chosen: far above
rounding, and far below any spacing that robots could keep."""


def scenario_names() -> list[str]:
    """Return the names of the built-in scenarios, in alphabetical order."""
    return built_in_names(SCENARIO.package)


def scenario_text(name: str) -> str:
    """Return the TOML text of a built-in scenario.

    Raises:
        InputError: no built-in scenario has that name.
    """
    return source_text(name, SCENARIO)


@dataclass(frozen=True)
class Mission:
    """Validated scenario with its template and the start of the team.

    Attributes:
        scenario: the scenario as given.
        template: the first shape: a point for each robot, in image sense (y down).
        ids: (N,) the robots, ascending; their markers, if each has one.
        positions_m: (N, 2) start positions on the ground, in the order of `ids`.
        headings_rad: (N,) start headings, counter-clockwise from +x.
        ground_image: grey picture (height, width) on the ground, or None.
        later: start time, s, and template of each shape after the first.
    """

    scenario: Scenario
    template: Template
    ids: IntArray
    positions_m: Array
    headings_rad: Array
    ground_image: Grey | None = None
    later: tuple[tuple[float, Template], ...] = ()

    def __repr__(self) -> str:
        scenario = self.scenario
        robots, units = self.ids.size, len(scenario.units)
        return f"Mission({scenario.name}: {robots} robots, {units} unit(s), {scenario.duration_s:g} s)"

    @cached_property
    def schedule(self) -> Schedule:
        """The shapes to form and their motions, each with its start time."""
        motions = tuple((model.at_s, model.motion) for model in self.scenario.template.motion)
        return Schedule(self.template, self.later, motions)

    def shape_at(self, time_s: float, roles: IntArray) -> Template:
        """Return the shape to form at a time, s; its points are in the order of the roles (N,)."""
        shape = self.schedule.at(time_s)
        if np.array_equal(roles, np.arange(roles.size)):
            return shape
        return Template(shape.ids, shape.points_px[roles])

    @cached_property
    def _settings(self) -> list[tuple[float, Scenario]]:
        """The scenario after each of its interventions, with its time, s; at first without any."""
        settings = [(-np.inf, self.scenario)]
        for intervention in self.scenario.interventions_in_order:
            settings.append((intervention.at_s, settings[-1][1].after(intervention)))
        return settings

    def scenario_at(self, time_s: float) -> Scenario:
        """Return the scenario with the settings that its interventions have made by a time, s."""
        made = bisect_right(self._settings, time_s + TIME_TOLERANCE_S, key=itemgetter(0))
        return self._settings[made - 1][1]

    def cameras_at(self, time_s: float) -> tuple[Camera, ...]:
        """Return the units' cameras at a time, s, at a zoom of 1."""
        return _make_cameras(tuple(unit.camera for unit in self.scenario_at(time_s).units))

    def with_interventions(self, added: Sequence[Intervention]) -> "Mission":
        """Return the mission with further interventions, after those that it has.

        Raises:
            InputError: an intervention is impossible; one line each, by its key.
        """
        if not added:
            return self
        scenario = self.scenario.model_copy(update={"interventions": [*self.scenario.interventions, *added]})
        problems, later = ProblemCollector(), list(self.later)
        settings = self.scenario_at(added[0].at_s)
        for number, intervention in enumerate(added, len(self.scenario.interventions)):
            where = f"interventions.{number}"
            with problems.collecting():
                if found := list(settings.intervention_problems(intervention)):
                    raise join_errors([problem.within_key(where) for problem in found])
                markers = self.ids if self.layout is None else self.layout.ids
                _check_marker(intervention, self.ids, np.union1d(markers, self.obstacle_ids), where)
                settings = settings.after(intervention)
                if isinstance(intervention, TemplateIntervention):
                    later.append((intervention.at_s, _later_shape(intervention, scenario, self.ids, where)))
        problems.raise_all()
        _check_times(scenario)
        return replace(self, scenario=scenario, later=tuple(sorted(later, key=itemgetter(0))))

    @cached_property
    def outlines(self) -> tuple[tuple[ComplexArray, ...], ...]:
        """Lines of each shape, polylines (M,) in image sense, in the template's units."""
        models = (self.scenario.template, *(model for _, model in self.scenario.later_shapes))
        shapes = (self.template, *(shape for _, shape in self.later))
        robots = self.scenario.robots
        return tuple(_outline(model, shape, robots) for model, shape in zip(models, shapes, strict=True))

    def outline_at(self, time_s: float) -> tuple[ComplexArray, ...]:
        """Return the lines of the shape to form at a time, s, in image sense; empty if it has none."""
        shape = self.schedule.at(time_s)
        shapes = (self.template, *(later for _, later in self.later))
        return next(lines for own, lines in zip(shapes, self.outlines, strict=True) if own is shape)

    @cached_property
    def bodies(self) -> Bodies:
        """Round bodies of robots and obstacles."""
        return self.scenario.make_bodies()

    @cached_property
    def layout(self) -> MarkerLayout | None:
        """The markers on the robots; None if each has one, at its reference point."""
        return _make_layout(self.scenario, self.ids)

    @cached_property
    def obstacle_ids(self) -> IntArray:
        """Markers (K,) of the obstacles, ascending."""
        return np.array([obstacle.id for obstacle in self.scenario.obstacles_by_id], dtype=np.int64)

    @cached_property
    def obstacle_headings_rad(self) -> Array:
        """Headings (K,) of the obstacles' markers, rad, in the order of their ids."""
        return np.radians([obstacle.heading_deg for obstacle in self.scenario.obstacles_by_id])

    @property
    def obstacle_positions_m(self) -> Array:
        """Centres (K, 2) of the obstacles on the ground, m, in the order of their ids."""
        return self.bodies.obstacles_m

    @property
    def obstacle_radii_m(self) -> Array:
        """Radii (K,) of the obstacles' bodies, m, in the order of their ids."""
        return self.bodies.obstacle_radii_m


@dataclass(frozen=True)
class ScenarioSource:
    """Content of a scenario before validation.

    Attributes:
        tree: dictionaries, lists and plain values, as in the TOML text.
        where: name of the scenario in error messages.
        folder: base folder of relative paths of pictures.
    """

    tree: dict[str, Any]
    where: str
    folder: Path


def read_scenario(name_or_file: str) -> ScenarioSource:
    """Read a built-in scenario or a TOML file without validation.

    Raises:
        InputError: the scenario or file does not exist, is not valid TOML, or is a file of another kind.
    """
    source = read_source(name_or_file, SCENARIO)
    return ScenarioSource(source.tree, source.where, source.folder)


def load_mission(
    name_or_file: str, settings: Iterable[str] | Mapping[str, object] = (), *, seed: int | None = None
) -> Mission:
    """Read, validate and complete a built-in scenario or a TOML file.

    Args:
        name_or_file: name of a built-in scenario, or a TOML file.
        settings: values that replace those of the file: by dotted key, such as `{"units.*.height_m": 9}`, or
            as texts, such as `["units.*.height_m=9"]`.
        seed: replaces the scenario's seed.

    Raises:
        InputError: one line per problem: the file or the option, the key, the value, and the allowed values.
    """
    check_kind("load_mission: name_or_file", name_or_file, (str, Path), "a scenario's name or file")
    source = read_scenario(name_or_file)
    origins = apply_settings(source.tree, settings, "control.k=0.2", SCENARIO.schema)
    if seed is not None:
        source.tree["seed"] = seed
        origins["seed"] = "seed"
    return make_mission(source.tree, where=source.where, folder=source.folder, origins=origins)


def make_mission(
    tree: dict[str, Any],
    *,
    where: str = "scenario",
    folder: Path | None = None,
    origins: Mapping[str, str] | None = None,
) -> Mission:
    """Validate and complete a scenario given as a tree of plain values.

    Args:
        tree: dictionaries, lists and plain values, as in a TOML file.
        where: name of the scenario in error messages.
        folder: base folder of relative paths of pictures; the working folder if None.
        origins: command-line options that set values, by dotted key; error messages name them.

    Raises:
        InputError: one line per problem: the key, the value, and the allowed values.
    """
    scenario = check_tree(Scenario, tree, where, see=SCENARIO.schema, origins=origins)
    try:
        return _complete(scenario, folder or Path())
    except InputError as error:
        problems = [
            InputError(locate(where, problem.where, origins or {}), problem.what, problem.allowed)
            for problem in error.problems
        ]
        raise join_errors(problems) from None


def _complete(scenario: Scenario, folder: Path) -> Mission:
    rng = generator(scenario.seed, RunStream.START_PLACES)
    problems = ProblemCollector()
    with problems.collecting():
        check_detector_name(scenario.detector)
        if scenario.perception == "noisy":
            load_accuracy(scenario.detector, noise=scenario.sensor.noise, psf_px=scenario.sensor.psf_px)
    ground_image = None
    with problems.collecting():
        picture = scenario.ground.image
        ground_image = None if picture is None else read_grey(folder / picture)
    team = None
    with problems.collecting():
        team = _team(scenario, folder, rng)
    problems.raise_all()
    if team is None:
        raise ValueError("a team without problems is complete")
    order = np.argsort(team.ids)
    return Mission(
        scenario=scenario,
        template=team.template,
        ids=team.ids[order],
        positions_m=team.positions_m[order],
        headings_rad=team.headings_rad[order],
        ground_image=ground_image,
        later=Schedule(team.template, tuple(team.later)).later,
    )


class _Team(NamedTuple):
    """Shapes and start of a team, robots in the order of the scenario."""

    template: Template
    later: list[tuple[float, Template]]
    ids: IntArray
    positions_m: Array
    headings_rad: Array


def _team(scenario: Scenario, folder: Path, rng: np.random.Generator) -> _Team:
    """Return the team of a scenario, or report all independent problems together."""
    dictionary = scenario.marker.dictionary
    limit = dictionary_size(dictionary)
    template = _template(scenario.template, scenario.robots, dictionary, folder)
    ids = _robot_ids(scenario.robots, template)
    marker_ids, layout = ids, _make_layout(scenario, ids)
    if layout is not None:
        marker_ids = layout.ids
    elif ids.max() >= limit:
        raise InputError(
            "robots.ids",
            f"{ids.size} robots, ids up to {ids.max()}, but {dictionary} has {limit} markers",
            f"ids from 0 to {limit - 1}, or a larger marker.dictionary",
        )
    problems, later = ProblemCollector(), []
    with problems.collecting():
        _check_faces(scenario, layout)
    with problems.collecting():
        _check_template(ids, template, "template")
        _check_outline(scenario.template, "template")
    for where, shape in scenario.later_shapes:
        with problems.collecting():
            later.append((shape.at_s, _later_shape(shape, scenario, ids, where, folder)))
    with problems.collecting():
        _check_times(scenario)
    obstacle_ids = np.array([obstacle.id for obstacle in scenario.obstacles], dtype=np.int64)
    for number, intervention in enumerate(scenario.interventions):
        with problems.collecting():
            known = np.union1d(marker_ids, obstacle_ids)
            _check_marker(intervention, ids, known, f"interventions.{number}")
    with problems.collecting():
        _check_classes(scenario, ids)
    with problems.collecting():
        robots = ids if layout is None else layout.robot_ids
        check_obstacles(scenario.obstacles, marker_ids, robots, scenario.marker)
    problems.raise_all()
    with problems.collecting():
        positions_m = start_positions(scenario, ids, template, rng)
    with problems.collecting():
        headings_rad = start_headings(scenario.robots, ids.size, rng)
    problems.raise_all()
    if scenario.roles.assigned != "none":
        template = with_assigned_roles(template, ids, positions_m, scenario.roles.assigned)
    return _Team(template, later, ids, positions_m, headings_rad)


def _template(
    model: ShapeModel, robots: RobotsModel, dictionary: str, folder: Path, where: str = "template"
) -> Template:
    if model.image is not None:
        return read_template_image(folder / model.image, dictionary)
    count = next(
        (len(given) for given in (robots.positions_m, robots.ids) if given is not None), robots.count
    )
    if model.points is not None:
        points = np.array(model.points, dtype=float).reshape(-1, 2)
    elif count is None:
        raise InputError("robots", "their number is not given", "give positions_m, ids or count")
    elif not 2 <= count <= dictionary_size(dictionary):
        allowed = f"from 2 to the {dictionary_size(dictionary)} markers of {dictionary}"
        raise InputError(
            "robots", f"{count} robots; {dictionary} has {dictionary_size(dictionary)} markers", allowed
        )
    else:
        points = _named_shape(model.shape or "", count, where)
    ids = np.arange(len(points)) if robots.ids is None else np.array(robots.ids)
    if len(ids) != len(points):
        raise InputError(
            f"{where}.points", f"{len(points)} points for {len(ids)} robots", "a point for each robot"
        )
    try:
        return Template.from_ground_points(ids, points)
    except DegenerateSetError as error:
        raise InputError(where, error.what, error.allowed) from None


def _later_shape(
    model: ShapeModel, scenario: Scenario, ids: IntArray, where: str, folder: Path = Path()
) -> Template:
    """Return a shape after the first, for the robots `ids` (N,); errors are located at the key `where`."""
    template = _template(model, scenario.robots, scenario.marker.dictionary, folder, where)
    _check_template(ids, template, where)
    _check_outline(model, where)
    return template


def _check_times(scenario: Scenario) -> None:
    """Check that motions ascend, and that later shapes begin after the start, in order, one at a time."""
    starts_s = [motion.at_s for motion in scenario.template.motion]
    if any(before >= after for before, after in pairwise(starts_s)):
        raise InputError("template.motion", f"times {starts_s} s", "times from 0 that ascend")
    times_s = [shape.at_s for shape in scenario.template.then]
    if any(before >= after for before, after in pairwise(times_s)):
        raise InputError("template.then", f"times {times_s} s", "times after 0 that ascend")
    before_s = 0.0
    for where, shape in scenario.later_shapes:
        if shape.at_s <= before_s:
            what = f"{shape.at_s:g}, when another shape begins"
            raise InputError(f"{where}.at_s", what, "a time after the start at which no other shape begins")
        before_s = shape.at_s


def _make_layout(scenario: Scenario, ids: IntArray) -> MarkerLayout | None:
    """Return the markers on robots `ids` (N,); None for one on each."""
    return make_layout(
        scenario.robots.markers,
        ids.tolist(),
        scenario.marker.dictionary,
        key="robots.markers",
        dictionary_key="marker.dictionary",
    )


def _check_faces(scenario: Scenario, layout: MarkerLayout | None) -> None:
    """Check that markers above the ground or on sides are rendered, and lie below all cameras."""
    if layout is None or layout.is_flat:
        return
    if scenario.perception != "rendered":
        what = f"{scenario.perception!r}, but robots.markers are above the ground or on sides"
        raise InputError("perception", what, "'rendered', or markers of height_sides 0 on top")
    top_m = scenario.marker.side_m * float(layout.points_sides[..., 2].max())
    if top_m >= scenario.autopilot.min_height_m:
        what = (
            f"markers up to {top_m:.3g} m, but autopilot.min_height_m is {scenario.autopilot.min_height_m:g}"
        )
        raise InputError("robots.markers", what, "markers below all cameras")


def _check_marker(intervention: Intervention, ids: IntArray, marker_ids: IntArray, where: str) -> None:
    """Check that the robot or marker of an intervention exists."""
    match intervention:
        case RobotIntervention():
            key, number, known = "robot", intervention.robot, ids
        case CoverIntervention():
            key, number, known = "marker", intervention.marker, marker_ids
        case _:
            return
    if number not in known:
        allowed = f"one of {shorten(', '.join(map(str, known.tolist())), MAX_SHOWN)}"
        raise InputError(f"{where}.{key}", f"no {key} {number}", allowed)


@lru_cache(maxsize=16)
def _make_cameras(models: tuple[CameraModel, ...]) -> tuple[Camera, ...]:
    return tuple(model.make() for model in models)


def _outline(model: ShapeModel, template: Template, robots: RobotsModel) -> tuple[ComplexArray, ...]:
    """Return the lines of a shape in image sense; none if the file gives neither lines nor a name."""
    if model.outline is not None:
        ids = np.arange(template.ids.size) if robots.ids is None else np.array(robots.ids)
        return tuple(template.points_of(ids[line]) for line in model.outline)
    if model.shape is None:
        return ()
    lines = shape_outline(model.shape, template.ids.size)
    return tuple(to_complex(line).conj() for line in lines)


def _check_outline(model: ShapeModel, where: str) -> None:
    if model.outline is None:
        return
    if model.points is None:
        raise InputError(f"{where}.outline", "no points that it may join", "points beside it")
    count = len(model.points)
    unknown = sorted({number for line in model.outline for number in line if number >= count})
    if unknown:
        what = f"no point(s) {', '.join(map(str, unknown))}"
        raise InputError(f"{where}.outline", what, f"numbers of points, from 0 to {count - 1}")


def _named_shape(name: str, count: int, where: str) -> Array:
    """Return the points of a named shape; errors name the key of the given shape."""
    try:
        return shape_points(name, count)
    except InputError as error:
        raise InputError(error.where.replace("template", where, 1), error.what, error.allowed) from None


def _robot_ids(robots: RobotsModel, template: Template) -> IntArray:
    count = len(robots.positions_m) if robots.positions_m is not None else robots.count or template.ids.size
    named = template.ids if template.ids.size == count else np.arange(count)
    ids = named if robots.ids is None else np.array(robots.ids, dtype=np.int64)
    if robots.count not in (None, count):
        what = f"{robots.count}, but {count} positions"
        raise InputError("robots.count", what, "the number of positions_m, or none")
    if ids.size < 2:
        raise InputError("robots", f"{ids.size} robot(s)", "at least two, since fewer make no shape")
    if np.unique(ids).size != ids.size:
        twice = sorted({int(i) for i in ids if np.sum(ids == i) > 1})
        raise InputError("robots.ids", f"duplicate ids {twice}", "each robot its own marker")
    if ids.size != count:
        raise InputError("robots.ids", f"{ids.size} ids for {count} robots", "an id for each robot")
    return ids


def _check_classes(scenario: Scenario, ids: IntArray) -> None:
    classes = scenario.roles.classes
    if classes is not None and len(classes) != ids.size:
        what = f"{len(classes)} classes for {ids.size} robots"
        raise InputError("roles.classes", what, "one for each, by ascending id")


def _check_template(ids: IntArray, template: Template, where: str) -> None:
    if (missing := np.setdiff1d(ids, template.ids)).size:
        raise InputError(where, f"no point for robot(s) {missing.tolist()}", "one point for each robot")
    if (extra := np.setdiff1d(template.ids, ids)).size:
        what = f"points for {extra.tolist()}, which are not robots"
        raise InputError(where, what, "one point for each robot")
    points = to_points(template.points_px)
    if (pair := coincident(points, SAME_POINT * float(np.ptp(points)))) is not None:
        first, second = template.ids[pair[0]], template.ids[pair[1]]
        what = f"robots {first} and {second} have one point"
        raise InputError(where, what, "each robot its own place")
