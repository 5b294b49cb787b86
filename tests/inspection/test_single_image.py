"""`skyherd.detect` and `skyherd.annotate`: one image in, detections or a picture out."""

import cv2
import numpy as np
import pytest

import skyherd
from skyherd.errors import InputError
from skyherd.files.images import LUMA
from skyherd.inspection.annotator import FOUND_COLOR
from skyherd.markers.dictionary import marker_cells

IDS = [4, 11, 30]


def scene(dictionary: str = "4X4_50", *, inverted: bool = False) -> np.ndarray:
    """Return a grey image of three markers of 48 px or more in a row."""
    image = np.full((140, 420), 140, np.uint8)
    for k, marker_id in enumerate(IDS):
        card = np.kron(np.pad(marker_cells(dictionary, marker_id), 1, constant_values=True), np.ones((8, 8)))
        image[20 : 20 + len(card), 140 * k + 20 : 140 * k + 20 + len(card)] = np.where(card, 230, 30)
    return 255 - image if inverted else image


class TestDetect:
    def test_grey_bgr_and_files_give_the_same_detections(self, tmp_path) -> None:
        grey = scene()
        cv2.imwrite(str(tmp_path / "photo.png"), grey)
        wide = np.stack([grey] * 3, axis=-1)
        wanted = skyherd.create_detector().detect(grey)
        assert wanted.ids.tolist() == IDS
        for image in (
            grey,
            grey[..., None],
            wide,
            np.asfortranarray(wide),
            tmp_path / "photo.png",
            str(tmp_path / "photo.png"),
        ):
            found = skyherd.detect(image)
            np.testing.assert_array_equal(found.centers_px, wanted.centers_px)
            np.testing.assert_array_equal(found.covariances, wanted.covariances)

    def test_colours_of_arrays_are_bgr(self) -> None:
        """A blue card has the grey level of blue light, and markers on it vanish if red and blue change."""
        dark, light = 30, 230
        marked = scene()
        image = np.zeros((*marked.shape, 3), np.uint8)
        image[..., 0] = np.where(marked == light, 255, 0)  # blue
        image[..., 2] = np.where(marked == dark, round(255 * LUMA[2] / LUMA[0]), 0)  # red, as bright
        assert skyherd.detect(image).ids.size == 0
        assert skyherd.detect(image[..., ::-1]).ids.tolist() == IDS

    @pytest.mark.parametrize(
        ("image", "options"),
        [
            (scene("5X5_50"), {"dictionary": "5X5_50"}),
            (scene("APRILTAG_36h11"), {"dictionary": "auto"}),
            (scene(inverted=True), {"inverted": True}),
            (scene("4X4_50@2"), {"border_bits": 2}),
            (scene(), {"detector": "opencv"}),
        ],
    )
    def test_options_are_those_of_the_verb(self, image, options) -> None:
        assert skyherd.detect(image, **options).ids.tolist() == IDS

    def test_repeated_id_is_reported_only_if_asked(self) -> None:
        twice = np.hstack([scene()[:, :140]] * 2)
        assert len(skyherd.detect(twice)) == 0
        assert skyherd.detect(twice, repeats=True).ids.tolist() == [4, 4]

    @pytest.mark.parametrize(
        "image",
        [None, [[0, 0]], np.zeros((4, 4)), np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4), np.uint8)],
    )
    def test_other_values_are_refused_in_one_line(self, image) -> None:
        with pytest.raises(InputError, match=r"^image: .*; a path, or an array of uint8, grey .* or BGR"):
            skyherd.detect(image)

    def test_missing_file_and_unknown_option_are_named(self, tmp_path) -> None:
        with pytest.raises(InputError, match=r"photo\.png: no such file"):
            skyherd.detect(tmp_path / "photo.png")
        with pytest.raises(InputError, match="dictionary: no dictionary '4X4'"):
            skyherd.detect(scene(), dictionary="4X4")


class TestAnnotate:
    def test_outline_is_drawn_around_each_marker(self) -> None:
        image = scene()
        found = skyherd.detect(image)
        picture = skyherd.annotate(image, found, min_side_px=1)
        assert picture.shape == (*image.shape, 3) and picture.dtype == np.uint8
        colored = (picture == FOUND_COLOR).all(axis=-1)
        for corners in found.corners_px:
            u, v = (corners[0] + corners[1]).round().astype(int) // 2
            assert colored[v - 3 : v + 4, u - 3 : u + 4].any()
        assert not (skyherd.annotate(image, found[:0], min_side_px=1) == FOUND_COLOR).all(axis=-1).any()

    def test_small_image_is_enlarged_by_a_whole_factor(self) -> None:
        image = scene()
        assert skyherd.annotate(image, skyherd.detect(image)).shape == (280, 840, 3)

    def test_image_of_another_size_is_refused(self) -> None:
        image = scene()
        with pytest.raises(InputError, match="420x100 px; the image of the detections, 420x140 px"):
            skyherd.annotate(image[:100], skyherd.detect(image))
        with pytest.raises(InputError, match="min_side_px: 0; a whole number above 0"):
            skyherd.annotate(image, skyherd.detect(image), min_side_px=0)
