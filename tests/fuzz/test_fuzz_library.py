"""What `import skyherd` offers, given nonsense: an object, an error of skyherd's own, or a TypeError."""

import contextlib
import inspect
import warnings
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
"""Values of no kind in particular."""

ARRAYS = arrays.arrays(
    st.sampled_from([np.float64, np.int64, np.complex128, np.uint8, np.bool_]),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
"""Arrays of any shape, with NaN and infinity where there are such."""

ANYTHING = SCALARS | ARRAYS | st.lists(SCALARS, max_size=3) | st.dictionaries(SCALARS, SCALARS, max_size=2)

NAMES = st.sampled_from(
    ["", "x", "4X4_50", "a:b", "os:getcwd", "star", "word:A", "a\0b", "/dev/zero", "n" * 400]
)
BY_TYPE = {str: NAMES, Path: NAMES.map(Path), Path | str: NAMES}
"""What is given where a text or a path is asked for: one of them, since nothing else has its methods."""

CALLED = (
    "Detections", "GoalInboxes", "Hover", "MarkerGains", "MotionGoals", "Rectifier",
    "SafetyRadius", "Template", "UnitReport", "VelocityCommand", "create_detector", "load_mission",
    "read_dataset", "read_recording", "shape_points",
)  # fmt: skip
"""Names of the entrance that are called; the others take objects that these make, or nothing."""


@st.composite
def calls(draw, target):
    """Arguments for a callable, by name: those that it needs, and some of the others."""
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
    """`detect(None)`, and arrays that are no grey images."""
    detector = skyherd.create_detector(name)
    refusal(lambda: detector.detect(image))


test_images, test_images_long = images


@pytest.mark.parametrize("name", ["photometric", "tracking", "opencv"])
def test_a_detector_of_no_dictionary_is_refused_when_it_is_made(name):
    with pytest.raises(skyherd.InputError, match="no dictionary 'x'"):
        skyherd.create_detector(name, dictionary="x")


@pytest.mark.parametrize(
    "border_bits", [0, 4, 1.5, "2", None, np.zeros(0), np.ones(2), float("nan")], ids=repr
)
def test_a_border_that_is_no_number_of_cells_is_refused(border_bits):
    with pytest.raises(skyherd.InputError, match="border bits"):
        skyherd.create_detector(border_bits=border_bits)
