"""Reader thread of cameras, with scripted sources and a simulated clock."""

import threading
from contextlib import contextmanager

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.live.cameras import CameraReader, Picture

LEVELS = np.arange(48 * 64, dtype=np.uint32).reshape(48, 64)


def image(number: int):
    """Return a unique picture (48, 64)."""
    return (LEVELS * (2 * number + 1) % 251).astype(np.uint8)


class Script:
    """Source that runs a script step by step: pictures, errors to raise, functions to call."""

    def __init__(self, *connections, lasting=True, pace="live") -> None:
        self.name, self.lasting, self.pace = "script", lasting, pace
        self.connections, self.opened = list(connections), 0
        self.go, self.done = threading.Semaphore(0), threading.Semaphore(0)
        self.waits: list[float] = []
        self.stop = threading.Event()

    def pause(self, seconds: float) -> bool:
        self.waits.append(seconds)
        return self.stop.is_set() or not self.connections

    @contextmanager
    def open(self, pause):
        self.opened += 1
        steps = self.connections.pop(0)
        if isinstance(steps, Exception):
            raise steps
        yield self.play(steps)

    def play(self, steps):
        for step in steps:
            self.go.acquire()
            if isinstance(step, Exception):
                raise step
            yield step
            self.done.release()
        if self.lasting:
            self.go.acquire()

    def step(self, count=1) -> None:
        """Let the source yield pictures, and wait until the reader asks for the next one."""
        for _ in range(count):
            self.go.release()
            assert self.done.acquire(timeout=20)


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def reader_of(script, clock):
    return CameraReader(script, clock=clock, pause=script.pause).start()


def end(reader, script) -> None:
    script.stop.set()
    script.go.release(100)
    reader.close()


class TestCamera:
    def test_newest_picture_is_returned_once(self, clock) -> None:
        script = Script([Picture(image(k)) for k in range(5)])
        reader = reader_of(script, clock)
        script.step(3)
        frame = reader.newest(0.0)
        assert (frame.number, reader.received, reader.dropped) == (2, 3, 2)
        assert np.array_equal(frame.image, image(2)) and not frame.image.flags.writeable
        assert reader.newest(0.0) is None
        script.step()
        assert reader.newest(0.0).number == 3 and reader.dropped == 2
        end(reader, script)
        assert reader.ended and reader.newest(0.0) is None

    def test_stamped_by_names_the_clock(self, clock) -> None:
        script = Script(
            [
                Picture(image(0)),
                Picture(image(1), age_s=0.25),
                *[Picture(image(2 + k), 7 + k / 10) for k in range(3)],
            ]
        )
        reader = reader_of(script, clock)
        script.step()
        frame = reader.newest(0.0)
        assert (frame.captured_s, frame.arrived_s, frame.stamped_by) == (100.0, 100.0, "arrival")
        clock.now_s = 101.0
        script.step()
        frame = reader.newest(0.0)
        assert (frame.captured_s, frame.arrived_s, frame.stamped_by) == (100.75, 101.0, "stream")
        for now_s in (102.0, 102.1, 102.25):
            clock.now_s = now_s
            script.step()
        frame = reader.newest(0.0)
        assert frame.captured_s == pytest.approx(102.2) and frame.arrived_s == 102.25
        assert frame.stamped_by == "stream"
        end(reader, script)

    def test_a_repeat_does_not_end_a_burst_of_buffered_pictures(self, clock) -> None:
        """A repeat has no interval, as if at pace. The next buffered picture would be stamped too late."""
        stream_s = [5.0, 5.1, 5.1, 5.2, 5.3, 5.4]
        script = Script([Picture(image(k), one) for k, one in enumerate(stream_s)])
        reader = reader_of(script, clock)
        script.step(4)  # all at once
        assert reader.newest(0.0) is None and (reader.received, reader.dropped) == (4, 4)
        clock.now_s += 0.1
        script.step()
        assert reader.newest(0.0).number == 4
        end(reader, script)

    def test_broken_source_reopens_after_growing_pauses(self, clock) -> None:
        gone = InputError("script", "connection refused", "a camera")
        script = Script([Picture(image(0)), ValueError("torn")], gone, gone, gone, [Picture(image(1))])
        reader = reader_of(script, clock)
        script.step()
        assert reader.newest(0.0).number == 0 and reader.trouble is None
        clock.now_s += 3.0
        script.go.release()  # It fails, is refused three times, and recovers.
        script.step()
        assert reader.newest(0.0).number == 1 and reader.reconnects == 1
        assert script.waits[:4] == [0.25, 0.5, 1.0, 2.0]
        assert reader.trouble is None
        end(reader, script)

    def test_trouble_of_broken_camera_has_reason_and_time(self, clock) -> None:
        script = Script([Picture(image(0)), InputError("script", "unplugged", "plug it in")])
        held, entered = threading.Event(), threading.Event()

        def pause(seconds):
            entered.set()
            held.wait(20)
            return True

        reader = CameraReader(script, clock=clock, pause=pause).start()
        script.step()
        script.go.release()
        assert entered.wait(20)
        clock.now_s += 4.0
        assert reader.trouble == "script: no picture for 4.0 s: unplugged"
        held.set()
        reader.close()

    def test_trouble_reports_stall_latency_and_old_pictures(self, clock) -> None:
        times = [0.0, 0.1, 0.2, 0.3, 0.4, 0.2, 0.3, 0.5]
        script = Script([Picture(image(k), stream_s) for k, stream_s in enumerate(times)])
        reader = reader_of(script, clock)
        for now_s in (100.0, 100.1, 100.2):
            clock.now_s = now_s
            script.step()
        assert reader.trouble is None
        clock.now_s = 102.0
        assert reader.trouble == "script: late: no picture for 1.8 s; the stream has stalled"
        script.step()
        assert "late: pictures take 1.7 s longer" in reader.trouble
        assert reader.newest(0.0).captured_s == pytest.approx(100.3, abs=1e-3), "it is as old as it is"
        script.step()
        newest = reader.newest(0.0)
        script.step(2)
        assert "pictures are no newer than an earlier one" in reader.trouble
        assert reader.newest(0.0) is None and newest.captured_s == pytest.approx(100.4, abs=1e-3)
        script.step()
        assert reader.newest(0.0).number == 7
        end(reader, script)

    @pytest.mark.parametrize("kept", [1, 3])
    def test_repeats_are_dropped_though_the_offset_of_clocks_rises(self, kept, clock) -> None:
        """A stamp that comes 1 s later would be 0.2 ms later by the drift that is allowed for."""
        times = [0.0, 0.1, 0.2, 0.2, 0.1, 0.2, 0.3]
        script = Script([Picture(image(k), stream_s) for k, stream_s in enumerate(times)])
        reader = CameraReader(script, clock=clock, pause=script.pause, kept=kept).start()
        numbers = []
        for stream_s in times:
            clock.now_s += 0.1 if stream_s != 0.2 else 1.0
            script.step()
            if (frame := reader.newest(0.0)) is not None:
                numbers.append(frame.number)
        assert [number for number in numbers if number] == [1, 2, 6]
        assert reader.dropped == 3 + (kept == 1)
        end(reader, script)

    def test_stream_with_restarted_clock_is_reopened(self, clock) -> None:
        again = [Picture(image(10 + k), 5 + k / 10) for k in range(3)]
        script = Script(
            [
                *[Picture(image(k), 50 + k / 10) for k in range(2)],
                Picture(image(3), 1.0),
                Picture(image(4), 4.1),
            ],
            again,
        )
        reader = reader_of(script, clock)
        for step_s in (0.1, 0.1, 0.1):
            clock.now_s += step_s
            script.step()
        clock.now_s += 3.1
        script.go.release()
        for _ in range(3):
            clock.now_s += 0.1
            script.step()
        assert reader.reconnects == 1 and reader.newest(0.0).number == 6
        assert reader.trouble is None
        end(reader, script)

    @pytest.mark.parametrize(
        ("picture", "words"),
        [
            (np.full((48, 64), 9, np.uint8), "black"),
            (np.full((48, 64), 90, np.uint8), "one even grey"),
            (image(1), "frozen: identical pictures for 2.0 s"),
        ],
    )
    def test_trouble_reports_black_even_and_frozen_pictures(self, picture, words, clock) -> None:
        script = Script([Picture(image(0)), *[Picture(picture.copy()) for _ in range(5)], Picture(image(2))])
        reader = reader_of(script, clock)
        script.step()
        assert reader.trouble is None
        for _ in range(5):
            script.step()
            clock.now_s += 0.5
        assert words in reader.trouble
        script.step()
        assert reader.trouble is None
        end(reader, script)


class TestRecording:
    def test_own_pace_waits_until_each_picture_is_due(self, clock) -> None:
        source = Script([Picture(image(k), k / 10) for k in range(3)], lasting=False, pace="own")
        source.go.release(3)
        waits = []

        def pause(seconds):
            waits.append(seconds)
            clock.now_s += seconds
            return False

        with CameraReader(source, clock=clock, pause=pause).start() as reader:
            reader._thread.join(20)
            frame = reader.newest(0.0)
        assert waits == pytest.approx([0.1, 0.1])
        assert frame.captured_s == pytest.approx(100.2) and frame.number == 2 and reader.dropped == 2
        assert reader.ended and reader.trouble is None

    def test_fast_pace_drops_no_picture(self, clock) -> None:
        source = Script([Picture(image(k), k / 10) for k in range(20)], lasting=False, pace="fast")
        source.go.release(20)
        reader = CameraReader(source, clock=clock).start()
        frames = []
        while not reader.ended:
            frame = reader.newest(20)
            frames += [] if frame is None else [frame]
        assert [frame.number for frame in frames] == list(range(20)) and reader.dropped == 0
        assert [frame.captured_s for frame in frames] == pytest.approx([100 + k / 10 for k in range(20)])


def test_failed_opening_is_one_clear_line(clock) -> None:
    for error, words in (
        (InputError("script", "no such", "another"), "no such"),
        (KeyError("k"), "KeyError"),
    ):
        script = Script(error)
        with pytest.raises(InputError, match=words):
            reader_of(script, clock)
        assert script.opened == 1


def test_slow_opening_times_out() -> None:
    held = threading.Event()

    class Slow(Script):
        @contextmanager
        def open(self, pause):
            held.wait(20)
            yield iter(())

    slow = CameraReader(Slow([]))
    with pytest.raises(InputError, match=r"did not open within 0\.05 s"):
        slow.start(timeout_s=0.05)
    held.set()
    assert slow.ended
