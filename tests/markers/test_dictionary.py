"""Names of marker dictionaries: skyherd's and OpenCV's are accepted everywhere."""

import cv2
import pytest

from skyherd.datasets import load_mission, make_mission, read_scenario
from skyherd.datasets.labelled.spec import load_spec, make_spec
from skyherd.errors import InputError
from skyherd.live.lab import load_lab
from skyherd.markers.dictionary import canonical_name, dictionary_names, dictionary_size, with_border
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
