"""Streams of random numbers: one for each purpose, all from one seed, listed here and nowhere else.

A stream's number is part of the seed sequence that NumPy's generator starts from, so that streams are
independent, and drawing more from one changes no other. The same seed therefore gives the same numbers for a
purpose whatever else a run contains. Two purposes with one number would draw the same numbers: `unique`
refuses that when the module is read.
"""

from enum import IntEnum, unique

import numpy as np


@unique
class RunStream(IntEnum):
    """What is drawn from the seed of a scenario or of a generated mission.

    A number never changes, so that a seed gives the same run with every version.
    """

    START_PLACES = 0
    PERCEPTION = 1
    MESSAGES = 2
    LOST_FRAMES = 3
    WHEEL_GAINS = 4
    WHEEL_SLIP = 5
    SWAY = 6
    ROBOT_CLOCKS = 7
    REPORTED_POSITIONS = 8
    RANDOM_MISSION = 71
    STAR_MISSION = 73
    CROWDED_MISSION = 79


@unique
class LabelledSetStream(IntEnum):
    """What is drawn from the seed of a labelled image set."""

    CAMERA = 0
    IMAGE = 1
    NOISE = 2
    PROCESSING = 3


def generator(seed: int, stream: RunStream | LabelledSetStream, *number: int) -> np.random.Generator:
    """The generator of a stream; `number` tells several of one kind apart, such as the cameras of a set."""
    return np.random.default_rng([seed, int(stream), *number])
