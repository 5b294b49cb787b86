"""Names of marker dictionaries: skyherd's and OpenCV's are accepted everywhere."""

import cv2
import numpy as np
import pytest

from skyherd.datasets import load_mission, make_mission, read_scenario
from skyherd.datasets.labelled.spec import load_spec, make_spec
from skyherd.errors import InputError
from skyherd.live.lab import load_lab
from skyherd.markers.dictionary import (
    all_marker_cells,
    border_cells,
    canonical_name,
    cells_per_side,
    dictionary_names,
    dictionary_size,
    load_dictionary,
    marker_cells,
    with_border,
)
from skyherd.vision import create_detector


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("DICT_4X4_50", "4X4_50"),
        ("4X4_50", "4X4_50"),
        ("DICT_APRILTAG_36h11", "APRILTAG_36h11"),
        ("APRILTAG_36H11", "APRILTAG_36h11"),
        ("dict_6x6_250", "6X6_250"),
        ("DICT_4X4_50@2", "4X4_50@2"),
        ("DICT_9X9", "DICT_9X9"),
        ("", ""),
    ],
)
def test_name_of_opencv_becomes_the_usual_one(given, name):
    assert canonical_name(given) == name


def test_every_name_of_opencv_is_known():
    theirs = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    assert theirs and all(dictionary_size(name) > 0 for name in theirs)
    assert {canonical_name(name) for name in theirs} <= set(dictionary_names())


def test_unknown_name_with_opencv_prefix_is_refused():
    with pytest.raises(InputError, match="no dictionary 'DICT_9X9'; one of 4X4_100"):
        dictionary_size("DICT_9X9")


def test_scenario_lab_and_spec_take_names_of_opencv():
    mission = load_mission("star", ["marker.dictionary=DICT_5X5_100"])
    assert mission.scenario.marker.dictionary == "5X5_100"
    tree = read_scenario("star").tree
    tree["marker"]["dictionary"] = "DICT_APRILTAG_36h11"
    assert make_mission(tree).scenario.marker.dictionary == "APRILTAG_36h11"
    lab = load_lab("webcams", ["markers.dictionary=DICT_APRILTAG_36h11"])
    assert lab.model.markers.dictionary == "APRILTAG_36h11"
    spec = load_spec("small").spec.model_dump() | {"markers": {"dictionary": "DICT_4X4_100"}}
    assert make_spec(spec).markers.dictionary == "4X4_100"


def test_detectors_and_borders_take_names_of_opencv():
    assert with_border("DICT_4X4_50", 2) == "4X4_50@2"
    assert create_detector("opencv", dictionary="DICT_APRILTAG_36h11")
    assert create_detector("photometric", dictionary="DICT_4X4_50", border_bits=2)


@pytest.mark.parametrize("name", ["4X4_50", "5X5_100@2", "6X6_250", "7X7_8000@3", "APRILTAG_36h11"])
def test_marker_cells_equal_those_that_opencv_draws(name) -> None:
    cells, border = all_marker_cells(name), border_cells(name)
    assert cells.shape == (dictionary_size(name), cells_per_side(name), cells_per_side(name))
    for marker_id in {0, 1, len(cells) // 2, len(cells) - 1}:
        drawn = cv2.aruco.generateImageMarker(
            load_dictionary(name), marker_id, cells_per_side(name), borderBits=border
        )
        np.testing.assert_array_equal(cells[marker_id], drawn > 127)
        np.testing.assert_array_equal(marker_cells(name, marker_id), cells[marker_id])
