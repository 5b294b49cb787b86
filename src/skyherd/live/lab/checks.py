"""What the keys of a lab file have to keep together, and those whose values are names of something."""

import re

from skyherd.datasets import check_obstacle_ids
from skyherd.errors import InputError
from skyherd.live.drivers import check_driver
from skyherd.live.lab.models import TEAM_PATTERN, LabModel
from skyherd.markers.dictionary import dictionary_names, dictionary_size
from skyherd.vision import detector_names


def check_model(model: LabModel, where: str) -> None:
    """Check what the types of a lab's keys leave open.

    Args:
        model: the lab.
        where: the file, or what to call it.

    Raises:
        InputError: in one line, the file, the key, the value, and what is allowed.
    """
    if not re.fullmatch(TEAM_PATTERN, model.team):
        raise InputError(
            f"{where}: team", repr(model.team), "1 to 40 letters, digits, _ and -, of which the first is no -"
        )
    limits = model.limits
    if limits.goal_timeout_s < 2 * limits.period_s:
        raise InputError(
            f"{where}: limits.goal_timeout_s",
            f"{limits.goal_timeout_s:g}",
            f"at least two period_s, which is {2 * limits.period_s:g}",
        )
    for unit, camera in enumerate(model.cameras):
        if camera.detector not in detector_names():
            raise InputError(
                f"{where}: cameras.{unit}.detector",
                f"no detector {camera.detector!r}",
                f"one of {', '.join(detector_names())}",
            )
    _check_markers(model, where)
    _check_shape(model, where)
    _check_bodies(model, where)


def check_drivers(model: LabModel, where: str, *, imports: bool = False) -> None:
    """Check the addresses of all drivers as far as that needs no hardware and no network.

    Args:
        model: the lab.
        where: the file, or what to call it.
        imports: also import factories of one's own, which have to be on this machine then.

    Raises:
        InputError: one is none that a driver can have.
    """
    addresses = [(f"robots.{index}", robot.id, robot.driver) for index, robot in enumerate(model.robots)]
    addresses += [
        (f"cameras.{unit}", unit, camera.driver)
        for unit, camera in enumerate(model.cameras)
        if camera.driver is not None
    ]
    for entry, number, address in addresses:
        try:
            check_driver(address, number, imports=imports)
        except InputError as error:
            shown = error.where.removeprefix("driver").strip()
            place = f"{where}: {entry}.driver" + (f": {shown}" if shown else "")
            raise InputError(place, error.what, error.allowed) from None


def _check_markers(model: LabModel, where: str) -> None:
    """Whether there is such a dictionary, and a marker of it for each robot."""
    dictionary = model.markers.dictionary
    if dictionary not in dictionary_names():
        raise InputError(
            f"{where}: markers.dictionary",
            f"no dictionary {dictionary!r}",
            f"one of {', '.join(dictionary_names())}",
        )
    size, seen = dictionary_size(dictionary), set[int]()
    for index, robot in enumerate(model.robots):
        if robot.id >= size:
            raise InputError(
                f"{where}: robots.{index}.id",
                f"{dictionary} has no marker {robot.id}",
                f"0 to {size - 1}, or a larger dictionary in markers.dictionary",
            )
        if robot.id in seen:
            raise InputError(
                f"{where}: robots.{index}.id",
                f"{robot.id} is there twice",
                "each robot its own marker",
            )
        seen.add(robot.id)


def _check_shape(model: LabModel, where: str) -> None:
    """Whether the shape is given once, and points for all robots if by points."""
    shape, robots = model.shape, len(model.robots)
    if (shape.shape is None) == (shape.points is None):
        both = "neither shape nor points" if shape.shape is None else "both shape and points"
        raise InputError(f"{where}: shape", both, "give exactly one of shape and points")
    if shape.points is not None and len(shape.points) != robots:
        raise InputError(
            f"{where}: shape.points",
            f"{len(shape.points)} points for {robots} robots",
            "a point for each",
        )


def _check_bodies(model: LabModel, where: str) -> None:
    """Check obstacles, and that the bound on robots' speed holds with the other keys."""
    avoidance, dictionary = model.avoidance, model.markers.dictionary
    try:
        check_obstacle_ids(
            model.obstacles,
            [robot.id for robot in model.robots],
            dictionary_size(dictionary),
            dictionary,
            "markers.dictionary",
        )
    except InputError as error:
        raise InputError(f"{where}: {error.where}", error.what, error.allowed) from None
    if not avoidance.on:
        return
    if avoidance.body_radius_sides <= 0:
        raise InputError(
            f"{where}: avoidance.body_radius_sides",
            "0 with avoidance.on",
            "the radius of the robots' bodies, in marker sides",
        )
    if avoidance.lifetime_s < model.limits.goal_timeout_s:
        raise InputError(
            f"{where}: avoidance.lifetime_s",
            f"{avoidance.lifetime_s:g}",
            f"at least limits.goal_timeout_s, which is {model.limits.goal_timeout_s:g}",
        )
    if model.control.axis_offset_m:
        raise InputError(
            f"{where}: control.axis_offset_m",
            f"{model.control.axis_offset_m:g} with avoidance.on",
            "0, the marker above the wheel axis; or avoidance.on = false",
        )
