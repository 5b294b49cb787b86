"""Real sources opened by `open_camera`: files, folders, streams on loopback, custom functions.

V4L2 devices use the same code as streams (`skyherd.live.cameras.streams.Stream`) with another format name.
The machines that run these tests have no such device.
"""

import io
import os
import socket
import threading
import time
from fractions import Fraction
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import av
import numpy as np
import pytest
from PIL import Image

from skyherd.errors import InputError
from skyherd.live.cameras import MirrorWatch, open_camera
from skyherd.live.cameras.recordings import ImageFolder
from skyherd.live.cameras.streams import V4L2, device_of, stream_of
from skyherd.markers.dictionary import load_dictionary
from skyherd.vision import create_detector

SIZE = 128, 192
"""Height and width of the pictures, px."""

BITS, BLOCK = 6, 32
"""Blocks that encode the number of a picture, and their side, px."""

WAIT_S = 30.0
"""Longest wait for an expected event, s. Chosen: enough for slow machines."""

POLL_S = 0.02
"""Longest delay of the end of a server, s."""


def drawn(number: int):
    """Return a picture that encodes a number in blocks, robust to compression."""
    picture = np.full(SIZE, 60, np.uint8)
    for bit in range(BITS):
        row, column = divmod(bit, 3)
        block = picture[16 + 56 * row : 16 + 56 * row + BLOCK, 16 + 56 * column : 16 + 56 * column + BLOCK]
        block[:] = 230 if number >> bit & 1 else 20
    return picture


def read(picture) -> int:
    """Return the number encoded in a picture."""
    centers = [(16 + 56 * (bit // 3) + BLOCK // 2, 16 + 56 * (bit % 3) + BLOCK // 2) for bit in range(BITS)]
    return sum((picture[center] > 128) << bit for bit, center in enumerate(centers))


def encode(target, form, numbers, *, rate_hz=10, wait=None) -> None:
    """Write pictures as H.264 into a file or to an address. Times count from 0."""
    with av.open(target, "w", format=form) as container:
        stream = container.add_stream("libx264", rate=rate_hz, options={"tune": "zerolatency", "g": "5"})
        stream.height, stream.width, stream.pix_fmt = *SIZE, "yuv420p"
        for k, number in enumerate(numbers):
            frame = av.VideoFrame.from_ndarray(drawn(number), format="gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = k, Fraction(1, rate_hz)
            container.mux(stream.encode(frame))
            if wait is not None:
                wait(k)
        container.mux(stream.encode(None))


def all_of(camera):
    frames = []
    while not camera.ended:
        frame = camera.newest(WAIT_S)
        frames += [] if frame is None else [frame]
    return frames


def until(camera, condition):
    """Return the first frame that meets a condition."""
    ends_s = time.monotonic() + WAIT_S
    while time.monotonic() < ends_s:
        frame = camera.newest(1.0)
        if frame is not None and condition(frame):
            return frame
    pytest.fail(f"nothing came: {camera.trouble}")


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "v.mp4"
    encode(str(path), "mp4", range(12))
    return path


class TestRecordings:
    def test_fast_video_drops_no_picture(self, video) -> None:
        with open_camera(str(video), pace="fast", clock=lambda: 50.0) as camera:
            frames = all_of(camera)
        assert [read(frame.image) for frame in frames] == list(range(12))
        assert [frame.captured_s for frame in frames] == pytest.approx([50 + k / 10 for k in range(12)])
        assert camera.dropped == 0 and {frame.stamped_by for frame in frames} == {"stream"}

    def test_video_at_own_pace_takes_its_duration(self, video) -> None:
        began_s = time.monotonic()
        with open_camera(str(video)) as camera:
            frames = all_of(camera)
        assert frames[-1].number == 11 and time.monotonic() - began_s >= 1.1
        assert all(frame.arrived_s >= frame.captured_s for frame in frames)

    @pytest.mark.parametrize("pace", ["own", "fast"])
    def test_invalid_files_are_refused(self, tmp_path, pace) -> None:
        os.mkfifo(tmp_path / "pipe.mp4")
        (tmp_path / "text.mp4").write_text("no video")
        for name, words in (
            ("pipe.mp4", "is a pipe"),
            ("text.mp4", "cannot be read"),
            ("none.mp4", "no such file"),
        ):
            with pytest.raises(InputError, match=words):
                open_camera(str(tmp_path / name), pace=pace)

    def test_folder_is_read_by_name(self, tmp_path) -> None:
        for number in (3, 1, 2):
            Image.fromarray(drawn(number)).save(tmp_path / f"{number}.png")
        with open_camera(str(tmp_path), pace="fast") as camera:
            assert [read(frame.image) for frame in all_of(camera)] == [1, 2, 3]
        (tmp_path / "empty").mkdir()
        with pytest.raises(InputError, match="no picture in this folder"):
            open_camera(str(tmp_path / "empty"), pace="fast")

    def test_growing_folder_yields_new_and_changed_pictures(self, tmp_path) -> None:
        """The camera writes one file slowly, and overwrites another one."""

        def write(name, number, *, kept=None):
            data = io.BytesIO()
            Image.fromarray(drawn(number)).save(data, format="PNG")
            (tmp_path / name).write_bytes(data.getvalue()[:kept])

        write("1.png", 1)
        with open_camera(str(tmp_path)) as camera:
            first = until(camera, lambda frame: True)
            assert read(first.image) == 1 and first.stamped_by == "stream"
            write("2.png", 2, kept=200)  # The incomplete file must not block the reader.
            assert camera.newest(0.2) is None and camera.trouble is None
            write("2.png", 2)
            assert read(until(camera, lambda frame: True).image) == 2
            for number in (3, 4):
                write("newest.png", number)
                assert read(until(camera, lambda frame: True).image) == number

    def test_growing_folder_yields_pictures_after_a_clock_reset(self, tmp_path) -> None:
        def write(number, age_s):
            path = tmp_path / f"{number}.part"
            Image.fromarray(drawn(number)).save(path, format="PNG")
            os.utime(path, (time.time() - age_s,) * 2)
            path.rename(tmp_path / f"{number}.png")

        for number in (1, 2):
            write(number, 0.0)
        source = ImageFolder(tmp_path, "live")
        pauses = iter(range(3, 9))

        def pause(seconds):
            number = next(pauses, None)
            if number is not None:
                write(number, 0.0 if number < 5 else 3600.0 - number)
            return number is None

        with source.open(pause) as pictures:
            assert [read(picture.image) for picture in pictures] == [2, 3, 4, 5, 6, 7, 8]


def pace(stop, moved) -> None:
    """Wait until the next picture is due, or end the sender."""
    if stop.wait(0.04) or moved.is_set():
        raise StopIteration


class Webcam(BaseHTTPRequestHandler):
    """Server of JPEG pictures in an endless response, like many cheap cameras."""

    def do_GET(self):
        self.server.asked += 1
        if self.headers.get("Authorization") is None and self.server.locked:
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="camera"')
            self.end_headers()
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=next")
        self.end_headers()
        number = 0
        while not self.server.stop.wait(0.02):
            data = io.BytesIO()
            Image.fromarray(drawn(number % 60)).save(data, format="JPEG", quality=90)
            head = f"--next\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data.getvalue())}\r\n\r\n"
            try:
                self.wfile.write(head.encode() + data.getvalue() + b"\r\n")
            except OSError:
                return
            number += 1

    def log_message(self, *_):
        pass


@pytest.fixture
def webcam():
    with ThreadingHTTPServer(("127.0.0.1", 0), Webcam) as server:
        server.asked, server.locked, server.stop = 0, False, threading.Event()
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True)
        thread.start()
        yield server
        server.stop.set()
        server.shutdown()


def test_custom_source_yields_pictures(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "own_camera.py").write_text(
        "import numpy as np\n"
        "from skyherd.live.cameras import Picture\n"
        "def levels(text):\n"
        "    yield np.full((4, 6), 77, np.uint8)\n"
        "    while True:\n"
        "        yield Picture(np.full((4, 6), int(text), np.uint8), age_s=0.5)\n"
        "def colour(text):\n"
        "    yield np.zeros((4, 6, 3))\n"
    )
    with open_camera("own_camera:levels=99") as camera:
        frame = until(camera, lambda frame: frame.number > 3)
        assert frame.image[0, 0] == 99 and frame.arrived_s - frame.captured_s == pytest.approx(0.5)
    with open_camera("own_camera:colour") as camera:
        assert camera.newest(0.2) is None
        assert "(4, 6, 3) of float64" in camera.trouble
    with pytest.raises(InputError, match="no attribute 'none'"):
        open_camera("own_camera:none")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("", "no camera"),
        ("nothing", "no camera 'nothing'"),
        ("99", r"/dev/video99: no such camera; devices that are there"),
        ("/dev/null?speed=3", "option speed=3"),
        ("ftp://host/x", "no address"),
        ("udp://127.0.0.1", "lacks a host or a port"),
        ("http://", "lacks a host"),
        ("http://[", "Invalid IPv6"),
        ("no_such_module:factory", "ModuleNotFoundError"),
    ],
)
def test_invalid_address_is_one_clear_line(address, words) -> None:
    with pytest.raises(InputError, match=words):
        open_camera(address)
    with pytest.raises(InputError, match="own or fast"):
        open_camera(address, pace="slow")


class TestStreams:
    @pytest.mark.parametrize("scheme", ["udp", "tcp"])
    def test_broken_stream_is_reopened(self, scheme, monkeypatch) -> None:
        """The stream is H.264 in MPEG-TS. A second sender with restarted times replaces the first one."""
        monkeypatch.setattr("skyherd.live.cameras.streams.READ_S", 1.0)
        port = free_port()
        stop, moved = threading.Event(), threading.Event()

        def send(first):
            target = f"udp://127.0.0.1:{port}?pkt_size=1316" if scheme == "udp" else f"tcp://127.0.0.1:{port}"
            numbers = iter(lambda: first, None)
            while not moved.is_set() and not stop.is_set():
                try:
                    encode(target, "mpegts", numbers, rate_hz=25, wait=lambda k: pace(stop, moved))
                except (OSError, StopIteration):
                    stop.wait(0.05)

        address = f"udp://127.0.0.1:{port}" if scheme == "udp" else f"tcp://127.0.0.1:{port}?listen=1"
        sender = threading.Thread(target=send, args=(5,), daemon=True)
        sender.start()
        try:
            with open_camera(address) as camera:
                frame = until(camera, lambda frame: True)
                assert read(frame.image) == 5 and frame.stamped_by == "stream"
                assert frame.captured_s <= frame.arrived_s <= time.monotonic()
                moved.set()
                sender.join(WAIT_S)
                moved.clear()
                sender = threading.Thread(target=send, args=(9,), daemon=True)
                sender.start()
                later = until(camera, lambda frame: read(frame.image) == 9)
                assert later.captured_s > frame.captured_s and camera.reconnects >= (scheme == "tcp")
        finally:
            stop.set()
            sender.join(WAIT_S)

    def test_jpeg_over_http_is_stamped_by_arrival(self, webcam) -> None:
        with open_camera(f"http://127.0.0.1:{webcam.server_port}/video") as camera:
            first = until(camera, lambda frame: True)
            later = until(camera, lambda frame: read(frame.image) > read(first.image))
        assert later.stamped_by == "arrival" and later.captured_s == later.arrived_s
        assert later.image.shape == SIZE

    def test_passwords_are_used_but_not_shown(self, webcam) -> None:
        webcam.locked = True
        address = f"127.0.0.1:{webcam.server_port}/video"
        with open_camera(f"http://me:secret@{address}") as camera:
            until(camera, lambda frame: True)
            assert "secret" not in camera.name
        with pytest.raises(InputError, match="401"):
            open_camera(f"http://{address}")
        with pytest.raises(InputError) as raised:
            open_camera(f"rtsp://me:secret@127.0.0.1:{free_port()}/1")
        assert "secret" not in str(raised.value) and "refused" in str(raised.value)

    def test_playlist_does_not_open_files(self, tmp_path, video) -> None:
        class Playlist(BaseHTTPRequestHandler):
            def do_GET(self):
                self.send_response(200)
                self.end_headers()
                self.wfile.write(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\nfile://{video}\n".encode())

            def log_message(self, *_):
                pass

        with ThreadingHTTPServer(("127.0.0.1", 0), Playlist) as server:
            threading.Thread(target=server.serve_forever, args=(POLL_S,), daemon=True).start()
            with pytest.raises(InputError):
                open_camera(f"http://127.0.0.1:{server.server_port}/list.m3u8")
            server.shutdown()

    def test_device_and_stream_share_one_class(self) -> None:
        device = device_of("/dev/null?size=1280x720&rate=30&format=mjpeg")
        assert device.form == V4L2 and type(device) is type(stream_of("rtsp://camera/1"))
        assert device.options == {"video_size": "1280x720", "framerate": "30", "input_format": "mjpeg"}
        assert V4L2 in av.formats_available

    def test_udp_listens_only_on_the_local_address(self) -> None:
        assert stream_of("udp://127.0.0.1:5000").options["localaddr"] == "127.0.0.1"
        assert "localaddr" not in stream_of("udp://239.1.1.1:5000").options


def test_mirrored_camera_is_reported() -> None:
    dictionary = load_dictionary("4X4_50")
    board = np.full((200, 400), 255, np.uint8)
    for k, marker in enumerate((1, 2, 3, 4)):
        board[60:140, 20 + 95 * k : 100 + 95 * k] = dictionary.generateImageMarker(marker, 80)
    detector = create_detector("opencv")
    now_s = 0.0
    watch = MirrorWatch("4X4_50", lambda: now_s)
    advice = {}
    for name, picture in (("mirrored", np.ascontiguousarray(board[:, ::-1])), ("upright", board)):
        for _ in range(5):
            now_s += 1.0
            frame = type("F", (), {"image": picture})
            advice[name] = watch.look(frame, detector.detect(picture))
    assert "the image is mirrored" in advice["mirrored"] and advice["upright"] is None
