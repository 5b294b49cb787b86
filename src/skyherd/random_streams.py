"""Random number streams, one per purpose, all derived from one seed and listed here.

A stream's number is part of the seed sequence of NumPy's generator. Streams are therefore independent, and
more draws from one stream change no other stream. Two purposes with one number would draw the same values:
`unique` rejects that on import.
"""

from enum import IntEnum, unique

import numpy as np


@unique
class RunStream(IntEnum):
    """Streams of random numbers of a scenario or a generated mission.

    Numbers never change, so that a seed gives the same run in every version.
    """

    START_PLACES = 0
    PERCEPTION = 1
    MESSAGES = 2
    LOST_FRAMES = 3
    WHEEL_GAINS = 4
    WHEEL_SLIP = 5
    SWAY = 6
    ROBOT_CLOCKS = 7
    TOLD_POSITIONS = 8
    RANDOM_MISSION = 71
    STAR_MISSION = 73
    CROWDED_MISSION = 79


@unique
class LabelledSetStream(IntEnum):
    """Streams of random numbers of a labelled image set."""

    CAMERA = 0
    IMAGE = 1
    NOISE = 2
    PROCESSING = 3


def generator(seed: int, stream: RunStream | LabelledSetStream, *number: int) -> np.random.Generator:
    """Return the generator of a stream; `number` distinguishes several of one kind, such as cameras."""
    return np.random.default_rng([seed, int(stream), *number])
