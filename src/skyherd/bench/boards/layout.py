"""Calibration boards: nominal corner positions of each marker on the board.

A table `board` in a set's table (`skyherd.bench.image_sets`):

    [webcam.board]
    kind = "charuco"     # or "aprilgrid", "aruco"
    columns = 8          # squares of a ChArUco board, markers of the others
    rows = 8
    marker = 0.75        # charuco: side of a marker, in sides of a square
    legacy = false       # charuco: the pattern of OpenCV before 4.6
    gap = 0.3            # aprilgrid and aruco: space between markers, in sides of a marker
    first_id = 0
    name = "monitor"     # sets with the same name show the same board; that of the set if left out
    degree = 5           # of the polynomials that model the lens; chosen by the errors if left out

An AprilGrid has Kalibr's order: ids run from the lower left, row by row upwards. The markers of an ArUco grid
have OpenCV's order: from the upper left, row by row downwards.
"""

from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import Field

from skyherd.datasets import Model
from skyherd.errors import InputError
from skyherd.geometry import Array
from skyherd.markers.dictionary import dictionary_size, load_dictionary

HALF_TURN = [2, 3, 0, 1]
"""Corner order of a marker rotated by 180 degrees: AprilTag's markers are upside down in OpenCV's
dictionaries (`skyherd.vision.detectors.peers`), and Kalibr prints them upright."""

UNIT_SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Corners of a marker, in its sides, x to the right and y down, in OpenCV's order."""


class BoardModel(Model):
    """A board with markers in rows and columns."""

    kind: Literal["charuco", "aprilgrid", "aruco"] = Field(description="kind of board")
    columns: Annotated[int, Field(ge=1, le=1000)] = Field(description="squares of charuco, else markers")
    rows: Annotated[int, Field(ge=1, le=1000)] = Field(description="squares of charuco, else markers")
    marker: Annotated[float, Field(gt=0, lt=1)] = Field(0.75, description="charuco: marker's side in squares")
    legacy: bool = Field(False, description="charuco: the pattern of OpenCV before 4.6")
    gap: Annotated[float, Field(gt=0, le=100)] = Field(
        0.3, description="space between markers, in their sides"
    )
    first_id: Annotated[int, Field(ge=0, le=100_000)] = Field(0, description="id of the first marker")
    name: str = Field("", description="name of the board; sets of one name share its layout corrections")
    degree: Annotated[int, Field(ge=2, le=7)] | None = Field(None, description="of the lens's polynomials")

    @property
    def markers(self) -> int:
        """Number of markers: on a ChArUco board one in every second square."""
        squares = self.columns * self.rows
        return squares // 2 if self.kind == "charuco" else squares

    def check_dictionary(self, dictionary: str, where: str) -> None:
        """Check that a dictionary has all its markers.

        Raises:
            InputError: a marker is missing, the board has no marker, or less than one square per side.
        """
        if self.kind == "charuco" and min(self.columns, self.rows) < 2:
            raise InputError(where, f"{self.columns} x {self.rows} squares", "charuco: at least 2 x 2")
        last, known = self.first_id + self.markers - 1, dictionary_size(dictionary)
        if last >= known:
            what = f"{self.markers} markers, ids up to {last}, but {dictionary} has {known}"
            raise InputError(where, what, "fewer columns and rows, a smaller first_id, or another dictionary")


def board_corners(board: BoardModel, dictionary: str) -> dict[int, Array]:
    """Return the corners (4, 2) of each marker on the board by id, in marker sides, x right and y down.

    They are in the order of `skyherd.geometry.SQUARE_CORNERS` on an upright board.
    """
    if board.kind == "charuco":
        made = cv2.aruco.CharucoBoard(
            (board.columns, board.rows), 1.0 / board.marker, 1.0, load_dictionary(dictionary)
        )
        made.setLegacyPattern(board.legacy)
        points = [np.asarray(corners, dtype=float)[:, :2] for corners in made.getObjPoints()]
        return {board.first_id + number: corners for number, corners in enumerate(points)}
    step = 1.0 + board.gap
    upwards = board.kind == "aprilgrid"
    square = UNIT_SQUARE[HALF_TURN] if upwards else UNIT_SQUARE
    return {
        board.first_id + row * board.columns + column: square
        + step * np.array([column, board.rows - 1 - row if upwards else row])
        for row in range(board.rows)
        for column in range(board.columns)
    }
