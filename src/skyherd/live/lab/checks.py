"""Checks of a lab that the types of its keys leave open: names, addresses, and keys that depend on others."""

import re
from collections.abc import Iterator, Mapping

from skyherd.datasets import check_obstacle_ids, locate, make_layout
from skyherd.errors import InputError, join_errors
from skyherd.live.drivers import check_driver
from skyherd.live.lab.models import TEAM_PATTERN, LabModel
from skyherd.markers.dictionary import dictionary_size
from skyherd.markers.layout import MarkerLayout
from skyherd.text import one_of
from skyherd.vision import detector_names

Problem = tuple[str, str, str]
"""Dotted key, fault of its value, and allowed values."""


def check_model(model: LabModel, where: str, origins: Mapping[str, str] | None = None) -> None:
    """Run all `CHECKS` of a lab, and report their problems together.

    Args:
        model: the lab.
        where: the file, or another name for error messages.
        origins: options that set values, by dotted key, for error messages.

    Raises:
        InputError: one line per problem: the file or option, the key, the value, and the allowed values.
    """
    problems = [
        InputError(locate(where, key, origins or {}), what, allowed)
        for check in CHECKS
        for key, what, allowed in check(model)
    ]
    if problems:
        raise join_errors(problems)


def check_drivers(
    model: LabModel, where: str, *, imports: bool = False, origins: Mapping[str, str] | None = None
) -> None:
    """Check the addresses of all drivers, without access to hardware or network.

    Args:
        model: the lab.
        where: the file, or another name for error messages.
        imports: also import the factories of custom drivers, which then must exist on this machine.
        origins: options that set values, by dotted key, for error messages.

    Raises:
        InputError: one line per invalid address.
    """
    addresses = [(f"robots.{index}", robot.id, robot.driver) for index, robot in enumerate(model.robots)]
    addresses += [
        (f"cameras.{unit}", unit, camera.driver)
        for unit, camera in enumerate(model.cameras)
        if camera.driver is not None
    ]
    problems = []
    for entry, number, address in addresses:
        try:
            check_driver(address, number, imports=imports)
        except InputError as error:
            shown = error.where.removeprefix("driver").strip()
            place = locate(where, f"{entry}.driver", origins or {}) + (f": {shown}" if shown else "")
            problems.append(InputError(place, error.what, error.allowed))
    if problems:
        raise join_errors(problems)


def make_lab_layout(model: LabModel) -> MarkerLayout | None:
    """Return the markers on the robots of a lab; None for one on each.

    Raises:
        InputError: two markers overlap or have one id, or a marker is not in the dictionary.
    """
    return make_layout(
        model.markers.on_robots,
        {robot.id for robot in model.robots},
        model.markers.dictionary,
        key="markers.on_robots",
        dictionary_key="markers.dictionary",
    )


def _name_problems(model: LabModel) -> Iterator[Problem]:
    """Check that the team's name is valid in topics."""
    if not re.fullmatch(TEAM_PATTERN, model.team):
        yield "team", repr(model.team), "1 to 40 letters, digits, _ and -; the first is not -"


def _limit_problems(model: LabModel) -> Iterator[Problem]:
    """Check that a goal stays fresh for at least two command periods."""
    limits = model.limits
    if limits.goal_timeout_s < 2 * limits.period_s:
        allowed = f"at least two period_s, which is {2 * limits.period_s:g}"
        yield "limits.goal_timeout_s", f"{limits.goal_timeout_s:g}", allowed


def _detector_problems(model: LabModel) -> Iterator[Problem]:
    """Check that the detectors exist."""
    names = detector_names()
    for unit, camera in enumerate(model.cameras):
        if camera.detector not in names:
            what = f"no detector {camera.detector!r}"
            yield f"cameras.{unit}.detector", what, one_of(camera.detector, names)


def _robot_problems(model: LabModel) -> Iterator[Problem]:
    """Check that the dictionary contains the robots' markers, and that no two robots share one."""
    dictionary = model.markers.dictionary
    size, seen = dictionary_size(dictionary), set[int]()
    try:
        make_lab_layout(model)
    except InputError as error:
        yield error.where, error.what, error.allowed
    for index, robot in enumerate(model.robots):
        if robot.id >= size and not model.markers.on_robots:
            allowed = f"0 to {size - 1}, or a larger dictionary in markers.dictionary"
            yield f"robots.{index}.id", f"{dictionary} has no marker {robot.id}", allowed
        if robot.id in seen:
            yield f"robots.{index}.id", f"{robot.id} is there twice", "each robot its own marker"
        seen.add(robot.id)


def _shape_problems(model: LabModel) -> Iterator[Problem]:
    """Check that exactly one of shape and points is given, and that each robot has a point."""
    shape, robots = model.shape, len(model.robots)
    if (shape.shape is None) == (shape.points is None):
        both = "neither shape nor points" if shape.shape is None else "both shape and points"
        yield "shape", both, "give exactly one of shape and points"
    elif shape.points is not None and len(shape.points) != robots:
        yield "shape.points", f"{len(shape.points)} points for {robots} robots", "a point for each"


def _body_problems(model: LabModel) -> Iterator[Problem]:
    """Check obstacles, and that the settings of avoidance are consistent with the other keys."""
    avoidance, dictionary = model.avoidance, model.markers.dictionary
    ids = [robot.id for robot in model.robots]
    try:
        layout = make_lab_layout(model)
        markers, robots = (ids, ids) if layout is None else (layout.ids.tolist(), layout.robot_ids.tolist())
    except InputError:  # a problem of the robots
        markers = robots = ids
    try:
        check_obstacle_ids(model.obstacles, markers, robots, dictionary, "markers.dictionary")
    except InputError as error:
        yield error.where, error.what, error.allowed
    if not avoidance.on:
        return
    if avoidance.body_radius_sides <= 0:
        allowed = "the radius of the robots' bodies, in marker sides"
        yield "avoidance.body_radius_sides", "0 with avoidance.on", allowed
    if avoidance.lifetime_s < model.limits.goal_timeout_s:
        allowed = f"at least limits.goal_timeout_s, which is {model.limits.goal_timeout_s:g}"
        yield "avoidance.lifetime_s", f"{avoidance.lifetime_s:g}", allowed
    if model.control.axis_offset_m:
        what = f"{model.control.axis_offset_m:g} with avoidance.on"
        yield "control.axis_offset_m", what, "0, the marker above the wheel axis; or avoidance.on = false"


CHECKS = (
    _name_problems,
    _limit_problems,
    _detector_problems,
    _robot_problems,
    _shape_problems,
    _body_problems,
)
"""Checks of a lab, in the order of their problems."""
