"""Creation of detectors by name and as `module:factory`, its errors, and the interface."""

import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.vision import (
    DEFAULT_DICTIONARY,
    Detector,
    create_detector,
    detections_of_corners,
    detector_names,
)
from skyherd.vision.detectors import registry
from skyherd.vision.detectors.registry import ENTRY_POINTS
from skyherd.vision.photometric.detector import PhotometricDetector

OWN_DETECTOR = '''
import numpy as np

from skyherd.errors import InputError
from skyherd.markers.dictionary import pose_of_corners
from skyherd.vision import detections_of_corners

NOT_A_FACTORY = 5


class Square:
    """Detects one marker in every image; its id is the length of the dictionary's name."""

    def __init__(self, dictionary):
        self.marker_id = len(dictionary)

    def detect(self, image, *, time_s=0.0, unit_id=0):
        corners = np.array([[[10.0, 20], [30, 20], [30, 40], [10, 40]]])
        centers, headings, sides = pose_of_corners(corners)
        return detections_of_corners(
            image,
            np.array([self.marker_id]),
            corners,
            headings_rad=headings,
            sides_px=sides,
            covariances=np.zeros((1, 3, 3)),
            time_s=time_s,
            unit_id=unit_id,
        )


def broken(dictionary):
    raise ZeroDivisionError("no luck")


def choosy(dictionary):
    raise InputError("detector choosy", f"does not know {dictionary}", "5X5_100")


def nothing(dictionary):
    return None
'''


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    """Create a module with a detector in the working directory, which is not in `sys.path`."""
    (tmp_path / "own_detector.py").write_text(OWN_DETECTOR, "utf-8")
    (tmp_path / "broken_module.py").write_text("1 / 0\n", "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield "own_detector"
    sys.modules.pop("own_detector", None)


def test_detector_outside_the_package_is_created_and_detects(own_module):
    detector: Detector = create_detector("own_detector:Square", dictionary="APRILTAG_36h11")
    found = detector.detect(np.zeros((60, 80), np.uint8), time_s=1.5, unit_id=2)
    assert found.ids.tolist() == [14] and (found.time_s, found.unit_id) == (1.5, 2)
    assert found.image_size_px.tolist() == [80, 60]
    np.testing.assert_allclose(found.centers_px, [[20.0, 30.0]])
    np.testing.assert_allclose(found.headings_rad, -np.pi / 2)
    np.testing.assert_allclose(found.sides_px, 20.0)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("own_detector:", "lacks a module or a factory; write it as module:factory"),
        (":Square", "lacks a module or a factory"),
        ("no_such_module:make", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("broken_module:make", "ZeroDivisionError: division by zero; a module that can be imported"),
        ("own_detector:Absent", "has no attribute 'Absent'"),
        ("own_detector:NOT_A_FACTORY", "'NOT_A_FACTORY' is not callable"),
        ("own_detector:broken", "ZeroDivisionError: no luck; factory\\('4X4_50'\\) that returns a detector"),
        ("own_detector:nothing", "the factory returned NoneType, which has no method detect"),
        (
            "photometrik",
            r"no detector 'photometrik'; did you mean 'photometric'\? one of .*, or module:factory",
        ),
        ("aruco", "^detector: no detector 'aruco'; photometric, or opencv for that of OpenCV alone$"),
    ],
)
def test_invalid_detector_name_or_factory_gives_input_error(own_module, name, words):
    with pytest.raises(InputError, match=words) as caught:
        create_detector(name)
    assert caught.value.where == ("detector" if ":" not in name else f"detector {name}")


def test_input_error_of_a_factory_is_propagated(own_module):
    with pytest.raises(InputError, match=r"^detector choosy: does not know 4X4_50; 5X5_100$"):
        create_detector("own_detector:choosy")


@pytest.fixture
def installed_detectors(own_module, monkeypatch):
    """Install entry points of three detectors: a new name, a built-in name, and an invalid factory."""
    found = [
        EntryPoint(name, f"{own_module}:{value}", ENTRY_POINTS)
        for name, value in (("squares", "Square"), ("opencv", "broken"), ("bad", "nothing"))
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: found if group == ENTRY_POINTS else [])
    registry._plugins.cache_clear()
    yield
    registry._plugins.cache_clear()


def test_installed_detector_is_created_by_its_name(installed_detectors, caplog):
    with caplog.at_level("INFO", logger="skyherd"):
        found = create_detector("squares", dictionary="APRILTAG_36h11").detect(np.zeros((9, 9), np.uint8))
    assert found.ids.tolist() == [14] and "squares" in detector_names()
    assert "detector squares is own_detector:Square" in caplog.text


def test_built_in_name_takes_precedence_over_entry_point(installed_detectors):
    assert len(create_detector("opencv").detect(np.zeros((60, 80), np.uint8))) == 0


def test_installed_factory_without_a_detector_is_refused(installed_detectors):
    with pytest.raises(InputError, match="the factory returned NoneType"):
        create_detector("bad")


@pytest.mark.parametrize("name", [name for name in detector_names() if name not in ("apriltag3", "napa")])
def test_every_detector_complies_with_the_interface(name):
    """No markers, the given time and unit id, an unchanged image, and an error for an invalid image."""
    detector = create_detector(name, dictionary=DEFAULT_DICTIONARY)
    image = np.full((90, 120), 128, np.uint8)
    image.setflags(write=False)
    found = detector.detect(image, time_s=2.5, unit_id=7)
    assert len(found) == 0 and (found.time_s, found.unit_id) == (2.5, 7)
    assert found.image_size_px.tolist() == [120, 90]
    for wrong in (np.zeros((9, 9, 3), np.uint8), np.zeros((9, 9)), np.zeros((0, 9), np.uint8)):
        with pytest.raises(InputError, match="grey"):
            detector.detect(wrong)


def test_corners_are_scaled_about_the_centre_to_a_given_side():
    corners = np.array([[[10.0, 20], [30, 20], [30, 40], [10, 40]]])
    found = detections_of_corners(
        np.zeros((60, 80), np.uint8),
        np.array([3]),
        corners,
        headings_rad=np.zeros(1),
        sides_px=np.array([10.0]),
        covariances=np.zeros((1, 3, 3)),
        time_s=0.0,
        unit_id=0,
    )
    np.testing.assert_allclose(found.corners_px, [[[15.0, 25], [25, 25], [25, 35], [15, 35]]])


def test_tracking_follows_and_photometric_does_not():
    tracking, photometric = (create_detector(name) for name in ("tracking", "photometric"))
    assert isinstance(tracking, PhotometricDetector) and tracking.following
    assert isinstance(photometric, PhotometricDetector) and not photometric.following


def test_quick_finds_the_same_markers_but_small_and_faint_ones(place_markers, draw_markers):
    """Markers of 9 and 30 px, the second alone also with a twelfth of the contrast."""
    rng = np.random.default_rng(0)
    matrices = place_markers([60 + 60j, 180 + 60j], 0.4, [9.0, 30.0])
    image = draw_markers(matrices, [3, 7], (240, 120), rng, noise=1.0, psf_px=0.5)
    faint = draw_markers(matrices[1:], [7], (240, 120), rng, noise=1.0, psf_px=0.5)
    faint = np.rint(128 + (faint.astype(float) - 128) / 12).astype(np.uint8)
    photometric, quick = (create_detector(name) for name in ("photometric", "quick"))
    assert photometric.detect(image).ids.tolist() == [3, 7]
    assert quick.detect(image).ids.tolist() == [7]
    np.testing.assert_array_equal(quick.detect(image).corners_px, photometric.detect(image).corners_px[1:])
    assert photometric.detect(faint).ids.tolist() == [7]
    assert quick.detect(faint).ids.tolist() == []


@pytest.mark.parametrize("name", ["photometric", "quick"])
def test_repeated_ids_are_reported_at_each_place_if_asked(place_markers, draw_markers, name):
    rng = np.random.default_rng(4)
    matrices = place_markers([60 + 60j, 180 + 60j], [0.4, 1.0], 30.0)
    image = draw_markers(matrices, [7, 7], (240, 120), rng)
    assert len(create_detector(name).detect(image)) == 0
    assert create_detector(name, repeats=True).detect(image).ids.tolist() == [7, 7]
    with pytest.raises(InputError, match="tracking leaves out ids that repeat"):
        create_detector("tracking", repeats=True)
