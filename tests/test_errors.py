"""Errors of several problems: their lines, their parts, and how they are joined."""

import importlib
import pkgutil

import numpy as np
import pytest

import skyherd
from skyherd.bench.entrants import EntrantError
from skyherd.control import Template
from skyherd.errors import (
    MAX_PROBLEMS,
    DegenerateSetError,
    InputError,
    InputErrors,
    MessageError,
    NativeLibraryError,
    OutputError,
    ProblemCollector,
    SingularSetError,
    SkyherdError,
    join_errors,
)
from skyherd.messages import MotionGoals

NO_INPUT_ERRORS = {InputError, OutputError, NativeLibraryError, EntrantError}
"""Direct subclasses of SkyherdError. All but the first are failures with valid input: of the disk, of the
installation, and of a measured detector."""


def problem(number: int) -> InputError:
    return InputError(f"key {number}", "wrong", "right")


def test_one_problem_stays_an_error_of_one_line():
    error = join_errors([problem(1), problem(1)])
    assert type(error) is InputError
    assert error.lines == (str(error),) == ("key 1: wrong; right",)


def test_several_problems_have_a_line_each():
    error = join_errors([problem(1), join_errors([problem(2), problem(3)])])
    assert isinstance(error, InputErrors) and isinstance(error, ValueError)
    assert str(error).splitlines() == [f"key {number}: wrong; right" for number in (1, 2, 3)]
    assert (error.where, error.what, error.allowed) == ("key 1", "wrong", "right")
    assert error.exit_code == 2


@pytest.mark.parametrize(
    ("count", "more", "last"), [(12, 0, "and 2 more problems"), (11, 0, "and 1 more problem")]
)
def test_problems_beyond_the_limit_are_counted(count, more, last):
    error = join_errors([problem(number) for number in range(count)], more)
    assert len(error.lines) == MAX_PROBLEMS + 1
    assert error.lines[-1] == last


def test_count_of_further_problems_survives_joining():
    assert join_errors([InputErrors([problem(1)], 4), problem(2)]).lines[-1] == "and 4 more problems"


def test_place_is_put_before_each_problem():
    assert join_errors([problem(1), problem(2)]).within("file").lines[1] == "file: key 2: wrong; right"
    assert InputError("", "a", "b").within_key("k").where == "k"
    assert InputError("x", "a", "b").within_key("k").where == "k.x"


def test_collector_raises_all_that_it_caught():
    collector = ProblemCollector()
    collector.raise_all()
    for number in (1, 2):
        with collector.collecting():
            raise problem(number)
    with pytest.raises(KeyError), collector.collecting():
        raise KeyError("no problem of the input")
    with pytest.raises(InputErrors, match=r"key 1[^\n]*\nkey 2"):
        collector.raise_all()


def test_every_error_of_bad_input_is_an_input_error():
    for module in pkgutil.walk_packages(skyherd.__path__, "skyherd."):
        # The compiled libraries are loaded by ctypes, and are no modules.
        if not module.name.endswith("__main__") and ".libskyherd_" not in module.name:
            importlib.import_module(module.name)
    assert set(SkyherdError.__subclasses__()) == NO_INPUT_ERRORS
    for kind in (MessageError, DegenerateSetError, SingularSetError):
        assert issubclass(kind, InputError) and kind.exit_code == 2


def test_bad_points_and_messages_name_place_and_allowed_values():
    with pytest.raises(InputError) as degenerate:
        Template([0, 1], np.array([2 + 1j, 2 + 1j]))
    assert str(degenerate.value) == "template: all points coincide; at least two distinct points"
    with pytest.raises(InputError) as message:
        MotionGoals(0, 0.0, [3], [-1.0], [0.0], [20.0], [[]], [[]])
    assert (message.value.where, message.value.allowed) == ("MotionGoals.rho_px", "0 or more")
