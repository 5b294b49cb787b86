"""Recall and jitter of `benchmarks/tracking_videos.py`, on known places."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def script(load_benchmark):
    return load_benchmark("tracking_videos")


def test_only_confirmed_markers_count_for_recall(script) -> None:
    """One tracker misses an image, and invents a marker; the other misses another image."""
    place = np.array([50.0, 60.0, 20.0])
    one = [{1: place}, {}, {1: place}, {1: place, 7: place}, {1: place}]
    other = [{1: place}, {1: place}, {1: place}, {1: place}, {}]
    agreed = script.agreed_places([one, other])
    assert [sorted(places) for places in agreed] == [[1]] * 5
    assert (script.share(one, agreed), script.share(other, agreed)) == (0.8, 0.8)
    far = [{1: place + np.array([30.0, 0.0, 0.0])}] * 5
    assert script.share(far, agreed) == 0.0


def test_jitter_is_that_of_the_noise_without_motion(script) -> None:
    """Markers that drift steadily, with noise of 0.05 px and 0.2 px; 400 images give 5 %."""
    rng = np.random.default_rng(2)

    def noisy(std_px):
        noise = rng.normal(0, std_px, (400, 3, 3)) * (1, 1, 0)
        return [
            {m: np.array([100 * m + 0.02 * k, 50.0, 60.0]) + noise[k, m] for m in range(3)}
            for k in range(400)
        ]

    jitter = script.jitters_px([noisy(0.05), noisy(0.2)])
    np.testing.assert_allclose(jitter, [0.05, 0.2], rtol=0.1)
    moving = [{1: np.array([5.0 * k, 0.0, 60.0])} for k in range(10)]
    assert np.isnan(script.jitters_px([moving, moving])).all()
