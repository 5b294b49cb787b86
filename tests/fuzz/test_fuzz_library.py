"""Public names with invalid arguments: an object, an error of skyherd, or a TypeError."""

import contextlib
import importlib
import inspect
import warnings
from enum import Enum
from pathlib import Path

import numpy as np
import pytest
from fuzzing import NASTY_VALUES, fuzzed, refusal
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import skyherd

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([2**63, -(2**70), float("nan"), float("inf"), 1e308, -1e308, 1e-320, 0.5]),
    st.sampled_from(["", "x", "4X4_50", "photometric", "os:getcwd", "a\0b", *NASTY_VALUES[:4]]),
)
"""Values of various types."""

ARRAYS = arrays.arrays(
    st.sampled_from([np.float64, np.int64, np.complex128, np.uint8, np.bool_]),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
"""Arrays of any shape, with NaN and infinity if the type has them."""

ANYTHING = SCALARS | ARRAYS | st.lists(SCALARS, max_size=3) | st.dictionaries(SCALARS, SCALARS, max_size=2)

NAMES = st.sampled_from(
    ["", "x", "4X4_50", "a:b", "os:getcwd", "star", "word:A", "a\0b", "/dev/zero", "n" * 400]
)
BY_TYPE = {str: NAMES, Path: NAMES.map(Path), Path | str: NAMES}
"""Values for arguments that are texts or paths; other types lack their methods."""

CALLED = (
    "AerialController", "Detections", "GoalInboxes", "Hover", "MarkerGains", "MotionGoals", "Rectifier",
    "SafetyRadius", "Template", "UnitReport", "VelocityCommand", "create_detector", "load_mission",
    "read_dataset", "read_recording", "robot_commands",
    "shape_points",
)  # fmt: skip
"""Public names that are called; the others take objects that these return, or nothing."""


@st.composite
def calls(draw, target):
    """Draw arguments for a callable, by name: the required ones and some of the others."""
    parameters = inspect.signature(target).parameters.values()
    return {
        parameter.name: draw(BY_TYPE.get(parameter.annotation, ANYTHING))
        for parameter in parameters
        if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        and (parameter.default is parameter.empty or draw(st.booleans()))
    }


@fuzzed(25, name=st.sampled_from(CALLED), data=st.data())
def entrance(name, data):
    target = getattr(skyherd, name)
    arguments = data.draw(calls(target))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a cast before the refusal
        with contextlib.suppress(TypeError):
            refusal(lambda: target(**arguments))


test_entrance, test_entrance_long = entrance


@fuzzed(8, image=ANYTHING, name=st.sampled_from(["photometric", "opencv"]))
def images(image, name):
    """Check `detect(None)`, and arrays that are not grey images."""
    detector = skyherd.create_detector(name)
    refusal(lambda: detector.detect(image))


test_images, test_images_long = images


@pytest.mark.parametrize("name", ["photometric", "tracking", "opencv"])
def test_detector_without_dictionary_is_refused(name):
    with pytest.raises(skyherd.InputError, match="no dictionary 'x'"):
        skyherd.create_detector(name, dictionary="x")


@pytest.mark.parametrize(
    "border_bits", [0, 4, 1.5, "2", None, np.zeros(0), np.ones(2), float("nan")], ids=repr
)
def test_border_that_is_no_number_of_cells_is_refused(border_bits):
    with pytest.raises(skyherd.InputError, match="border bits"):
        skyherd.create_detector(border_bits=border_bits)


FACADES = ("skyherd", "skyherd.control", "skyherd.vision", "skyherd.render", "skyherd.datasets")
"""Modules whose public names users call."""


INTERNAL = {
    "apply_settings",
    "check_obstacle_ids",
    "check_tree",
    "locate",
    "read_source",
    "refuse_configuration",
    "refuse_other_kind",
    "source_text",
}
"""Names of `skyherd.datasets` with which labs and studies read their files. Users call functions such as
`load_mission`, which check their arguments."""


def is_left_out(target):
    """Return whether a class is a protocol, data model, enumeration, or error without a constructor."""
    is_plain_error = issubclass(target, BaseException) and "__init__" not in vars(target)
    is_model = hasattr(target, "model_validate") or issubclass(target, Enum)
    return getattr(target, "_is_protocol", False) or is_model or is_plain_error


def public_callables():
    """Yield public functions and classes by their names."""
    for facade in FACADES:
        module = importlib.import_module(facade)
        for name in module.__all__:
            target = getattr(module, name)
            if name in INTERNAL:
                continue
            if inspect.isfunction(target) or (inspect.isclass(target) and not is_left_out(target)):
                yield f"{facade}.{name}", target


CALLABLES = dict(public_callables())

SAME = (
    None, True, 3, 2**70, "x", Path("nowhere"), np.zeros(0), np.ones(2), np.ones((2, 2)), np.array(3), [1, 2],
    [None], {}, {1: 2}, object(),
)  # fmt: skip
"""Values that replace all required arguments of a callable, one at a time."""


def call_as_nonsense(target, values):
    """Call with these values in turn for the required arguments; only an AttributeError propagates."""
    parameters = [
        parameter
        for parameter in inspect.signature(target).parameters.values()
        if parameter.default is parameter.empty
        and parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    ]
    arguments = {parameter.name: values[row % len(values)] for row, parameter in enumerate(parameters)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = target(**arguments)
            if inspect.isgenerator(result):
                next(result, None)
        except AttributeError:
            raise
        except Exception:
            return


@pytest.mark.parametrize("name", CALLABLES)
def test_nonsense_arguments_give_no_attribute_error(name):
    """Each value replaces all arguments, and mixtures are drawn from a fixed seed."""
    rng = np.random.default_rng(7)
    for value in SAME:
        call_as_nonsense(CALLABLES[name], [value])
    for _ in range(10):
        call_as_nonsense(CALLABLES[name], [SAME[k] for k in rng.integers(len(SAME), size=6)])


def test_check_detects_attribute_error_of_nonsense():
    with pytest.raises(AttributeError):
        call_as_nonsense(lambda seen: seen.ids, [3])
