"""Images of rosbag2 recordings, against what `rosbags` wrote."""

import sys
import warnings

import cv2
import numpy as np
import pytest
from bags import compressed, raw, text, write_bag
from command_line import assert_refused, call

from skyherd.errors import InputError, InputWarning
from skyherd.files.image_streams import is_stream, open_stream, read_stream
from skyherd.files.ros_images import ENCODINGS

IMAGES = np.random.default_rng(1).integers(0, 256, (3, 40, 60), dtype=np.uint8)
"""Grey images (3, height, width)."""


def read(path, topic=None):
    """Return the frames of a bag, of which no warning is expected."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return list(read_stream(open_stream(path, topic)))


def problem(path, topic=None) -> str:
    """Return the error of a bag."""
    with pytest.raises(InputError) as error:
        read(path, topic)
    assert "\n" not in str(error.value)
    return str(error.value)


class TestImages:
    @pytest.mark.parametrize("storage", [".mcap", ".db3"])
    @pytest.mark.parametrize("make", [lambda i, t: raw(i, "mono8", t), compressed], ids=["raw", "compressed"])
    def test_bag_gives_its_images_and_their_stamps(self, tmp_path, storage, make) -> None:
        times_s = [0.0, 0.13, 0.21]
        messages = [("/camera", make(image, time_s)) for image, time_s in zip(IMAGES, times_s, strict=True)]
        bag = write_bag(tmp_path / "bag", [("/words", text("hello")), *messages], storage=storage)
        for path in (bag, next(bag.glob(f"*{storage}"))):
            assert is_stream(path)
            frames = read(path)
            np.testing.assert_array_equal([frame.image for frame in frames], IMAGES)
            assert [frame.time_s for frame in frames] == pytest.approx(times_s, abs=1e-9)
            assert [frame.index for frame in frames] == [0, 1, 2]
            assert open_stream(path).count == 3

    def test_images_without_stamps_have_the_times_of_the_bag(self, tmp_path) -> None:
        messages = [("/camera", compressed(image, stamped=False)) for image in IMAGES]
        frames = read(write_bag(tmp_path / "bag", messages, every_s=0.25))
        assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.25, 0.5])

    def test_topic_chooses_among_cameras(self, tmp_path) -> None:
        bag = write_bag(tmp_path / "bag", [(f"/unit_{k}", compressed(IMAGES[k])) for k in range(3)])
        for number in range(3):
            (frame,) = read(bag, f"/unit_{number}")
            np.testing.assert_array_equal(frame.image, IMAGES[number])

    @pytest.mark.parametrize("big", [False, True])
    def test_padding_and_byte_order_do_not_matter(self, tmp_path, big) -> None:
        """Levels of 12 bits in 16, of which the brightest is white."""
        levels = IMAGES[0].astype(np.uint16) * 16
        levels[0, 0] = 4095
        (frame,) = read(write_bag(tmp_path / "bag", [("/c", raw(levels, "mono16", padding=6, big=big))]))
        np.testing.assert_array_equal(frame.image, np.rint(levels / 4095 * 255))

    @pytest.mark.parametrize("encoding", sorted(ENCODINGS))
    def test_every_encoding_gives_the_luminance(self, tmp_path, encoding) -> None:
        """A picture of one colour, orange, and one of grey levels where there is no colour."""
        red, green, blue = 200, 120, 40
        luma = 0.299 * red + 0.587 * green + 0.114 * blue
        number, channels, _ = ENCODINGS[encoding]
        levels = np.zeros((8, 12, channels))
        order = {"rgb": (red, green, blue), "bgr": (blue, green, red), "8UC": (blue, green, red)}
        if channels >= 3:
            levels[..., :3] = order[encoding[:3]]
        elif "bayer" in encoding:
            place = {"r": red, "g": green, "b": blue}
            pattern = [place[letter] for letter in encoding[6:10]]
            levels[..., 0] = np.tile(np.reshape(pattern, (2, 2)), (4, 6))
        elif channels == 2:
            is_first = encoding in ("yuyv", "yuv422_yuy2")
            levels[:] = (luma, 128) if is_first else (128, luma)
            levels = np.rint(levels)
        else:
            levels[:] = luma
        kind = np.dtype(number)
        scale = 257 if kind.itemsize == 2 else 1
        if kind.itemsize == 2:
            levels[0, 0] = 255
        (frame,) = read(
            write_bag(tmp_path / "bag", [("/c", raw(np.rint(levels * scale).astype(kind), encoding))])
        )
        assert frame.image.shape == (8, 12)
        np.testing.assert_allclose(frame.image[2:-2, 2:-2], luma, atol=1)


class TestProblems:
    def test_bag_without_images_says_so(self, tmp_path) -> None:
        assert "has no image topic" in problem(write_bag(tmp_path / "bag", [("/words", text("hello"))]))

    def test_several_topics_are_named(self, tmp_path) -> None:
        bag = write_bag(
            tmp_path / "bag", [("/b", compressed(IMAGES[0])), ("/a/raw", raw(IMAGES[1], "mono8"))]
        )
        assert "has 2 image topics; choose one with `topic=`: /a/raw, /b" in problem(bag)
        assert "has no image topic '/c'; one of /a/raw, /b" in problem(bag, "/c")

    def test_unknown_encodings_are_named(self, tmp_path) -> None:
        odd = write_bag(tmp_path / "odd", [("/c", raw(np.ones((4, 4), np.float32), "32FC1"))])
        assert "/c: image 0: encoding '32FC1' is not read; one of mono8, " in problem(odd)
        deep = compressed(IMAGES[0])
        deep.format = "16UC1; compressedDepth png"
        assert "compressedDepth" in problem(write_bag(tmp_path / "deep", [("/c", deep)]))

    def test_damaged_image_is_left_out_with_a_warning(self, tmp_path) -> None:
        messages = [compressed(image, 0.1 * number) for number, image in enumerate(IMAGES)]
        messages[1].data = messages[1].data[:50]
        short = raw(IMAGES[0], "mono8", 0.3)
        short.data = short.data[:-1]
        bag = write_bag(tmp_path / "bag", [("/c", message) for message in messages])
        with pytest.warns(InputWarning, match="2 images are read, 1 are not"):
            frames = list(read_stream(open_stream(bag)))
        assert [frame.index for frame in frames] == [0, 1]
        assert frames[1].time_s == pytest.approx(0.2)
        np.testing.assert_array_equal(frames[1].image, IMAGES[2])
        assert "damaged: 60x40 px" in problem(write_bag(tmp_path / "all", [("/c", short)]))

    @pytest.mark.parametrize("storage", [".mcap", ".db3"])
    @pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.7, 0.99])
    def test_file_cut_short_gives_one_line_or_some_images(self, tmp_path, storage, share) -> None:
        bag = write_bag(tmp_path / "bag", [("/c", raw(image, "mono8")) for image in IMAGES], storage=storage)
        file = next(bag.glob(f"*{storage}"))
        file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            try:
                found = len(list(read_stream(open_stream(bag))))
            except InputError as error:
                assert "\n" not in str(error) and str(bag) in str(error)
            else:
                assert 0 < found <= 3 and (found == 3 or warned)

    def test_other_files_are_no_bags(self, tmp_path) -> None:
        (tmp_path / "metadata.yaml").write_text("author: me\n")
        (tmp_path / "run.mcap").write_bytes(b"\x89MCAP0\r\n\x01" + bytes(40))
        assert not is_stream(tmp_path) and not is_stream(tmp_path / "run.mcap")
        assert not is_stream(tmp_path / "none.db3")

    def test_missing_library_is_named(self, tmp_path, monkeypatch) -> None:
        bag = write_bag(tmp_path / "bag", [("/c", compressed(IMAGES[0]))])
        monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
        assert "rosbags is not installed; pip install 'skyherd[ros]'" in problem(bag)


@pytest.fixture(scope="module")
def marked(tmp_path_factory):
    """A bag of three images with the markers 4, 11 and 30."""
    from skyherd.markers.dictionary import marker_cells

    image = np.full((120, 340), 140, np.uint8)
    for place, marker in enumerate((4, 11, 30)):
        cells = np.pad(marker_cells("4X4_50", marker), 1, constant_values=True)
        card = np.kron(np.where(cells, 230, 30), np.ones((8, 8))).astype(np.uint8)
        image[60 - 32 : 60 + 32, 60 + 100 * place - 32 : 60 + 100 * place + 32] = card
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    folder = tmp_path_factory.mktemp("bags") / "marked"
    return write_bag(folder, [("/c", raw(image, "mono8", 0.1 * number)) for number in range(3)])


class TestVerbs:
    def test_detect_and_track_read_bags(self, marked, tmp_path, capsys, monkeypatch) -> None:
        monkeypatch.chdir(tmp_path)
        for number, path in enumerate((marked, next(marked.glob("*.mcap")))):
            code, out, err = call(capsys, "detect", path, "--out", f"found{number}")
            assert (code, err) == (0, "") and "4, 11, 30" in out and (tmp_path / "found0/marked.mp4").exists()
            rows = (tmp_path / f"found{number}/detections.csv").read_text().splitlines()
            assert len(rows) == 10
            code, out, err = call(capsys, "track", path, "--topic", "/c", "--out", f"tracks{number}")
            assert (code, err) == (0, "")
            assert len((tmp_path / f"tracks{number}/tracks.csv").read_text().splitlines()) == 10

    def test_topic_of_a_video_is_refused(self, marked, tmp_path, capsys, monkeypatch) -> None:
        monkeypatch.chdir(tmp_path)
        cv2.imwrite("a.png", IMAGES[0])
        assert_refused(call(capsys, "detect", "a.png", "--topic", "/c"), "--topic: a.png is not a rosbag2")
        assert_refused(call(capsys, "track", marked, "--topic", "/d"), "has no image topic '/d'; one of /c")
        assert not (tmp_path / "tracks").exists() and not (tmp_path / "detections").exists()
