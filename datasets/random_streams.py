"""Streams of random numbers: one per purpose, all from one seed, defined only here.

A stream's number is part of the seed sequence of NumPy's generator. Streams are therefore independent, and
drawing more from one changes no other. The same seed gives the same numbers for a purpose, independent of the
other parts of a run. Two purposes with one number would draw the same numbers: `unique` rejects that at
import.
"""

from enum import IntEnum, unique

import numpy as np


@unique
class RunStream(IntEnum):
    """Purposes of random numbers from the seed of a scenario or a generated mission.

    A number never changes, so that a seed gives the same run in every version.
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
    EPISODES = 9
    RANDOM_MISSION = 71
    STAR_MISSION = 73
    CROWDED_MISSION = 79


@unique
class LabelledSetStream(IntEnum):
    """Purposes of random numbers from the seed of a labelled image set."""

    CAMERA = 0
    IMAGE = 1
    NOISE = 2
    PROCESSING = 3


def generator(seed: int, stream: RunStream | LabelledSetStream, *number: int) -> np.random.Generator:
    """Return the generator of a stream; `number` distinguishes several of a kind, such as cameras."""
    return np.random.default_rng([seed, int(stream), *number])
