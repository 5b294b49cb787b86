"""Foxglove messages: schemas, pixel coordinates, and sense of rotation."""

import base64

import cv2
import numpy as np
import pytest
from plain_messages import assert_valid, plain

from skyherd.recording import foxglove


@pytest.fixture
def overlay():
    drawn = foxglove.Overlay(12.25, scale=0.5)
    drawn.lines(foxglove.LINE_LOOP, np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 20.0]]), "#ff8000")
    drawn.circle(np.array([99.5, 49.5]), 8.0, "#000000")
    drawn.text(np.array([-0.5, 639.5]), "17", "#ffffff", "#000000")
    return plain(drawn.message)


def test_overlays_follow_schema(overlay) -> None:
    assert_valid(overlay, foxglove.ANNOTATIONS[1])
    assert [len(overlay[kind]) for kind in ("circles", "points", "texts")] == [1, 1, 1]
    with pytest.raises(AssertionError):
        assert_valid(overlay | {"more": []}, foxglove.ANNOTATIONS[1])
    del overlay["circles"][0]["diameter"]
    with pytest.raises(AssertionError, match=r"\.circles\[\]"):
        assert_valid(overlay, foxglove.ANNOTATIONS[1])


def test_pixels_start_at_corner_and_scale(overlay) -> None:
    assert overlay["circles"][0]["position"] == {"x": 50.0, "y": 25.0}
    assert overlay["points"][0]["points"][2] == {"x": 5.25, "y": 10.25}
    assert overlay["texts"][0]["position"] == {"x": 0.0, "y": 320.0}
    assert overlay["points"][0]["outline_color"] == {"r": 1.0, "g": 128 / 255, "b": 0.0, "a": 1.0}
    assert overlay["texts"][0]["timestamp"] == {"sec": 12, "nsec": 250_000_000}


def test_image_is_decoded_again() -> None:
    image = np.add.outer(np.arange(48), 2 * np.arange(64)).astype(np.uint8)
    message = plain(foxglove.compressed_image(image, 1.5, "unit/0/camera", 90))
    assert_valid(message, foxglove.IMAGE[1])
    data = np.frombuffer(base64.b64decode(message["data"]), np.uint8)
    back = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert message["format"] == "jpeg" and np.abs(back.astype(int) - image).mean() < 2


def test_transforms_rotate_counter_clockwise() -> None:
    """By Foxglove's own example: a quarter turn maps (1, 0) of the child to (x, y + 1)."""
    message = plain(foxglove.frame_transforms(2.0, "ground", {"robot": (1.0, 2.0, 3.0, np.pi / 2)}))
    assert_valid(message, foxglove.TRANSFORMS[1])
    (transform,) = message["transforms"]
    z, w = transform["rotation"]["z"], transform["rotation"]["w"]
    x, y = 1 - 2 * z * z, 2 * z * w
    assert (transform["translation"]["x"] + x, transform["translation"]["y"] + y) == pytest.approx((1, 3))
