"""Streaks of motion, steep tilts and covers, over rendered truth: errors are as large as covariances say."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from skyherd.bench.detectors.design import Cell
from skyherd.bench.detectors.frames import rendered_frames
from skyherd.bench.detectors.scorer import Scorer, match
from skyherd.geometry import wrap_angle
from skyherd.vision.photometric import measure, refine
from skyherd.vision.photometric.detector import PhotometricDetector
from skyherd.vision.photometric.fitting import occlusion
from skyherd.vision.photometric.fitting.streak_evidence import StreakEvidence

DICTIONARY = "4X4_50"


def score(seed, cameras, frames, **factors):
    """Of markers of 30 px at noise 5 unless told otherwise, each image taken by itself."""
    detector, scorer = PhotometricDetector(DICTIONARY, following=False), Scorer()
    for frame in rendered_frames(replace(Cell(cameras=cameras, frames=frames), **factors), DICTIONARY, seed):
        scorer.add(frame, detector.detect(frame.image, unit_id=frame.unit_id))
    return scorer.score()


def is_round(image, dictionary, fits, good, shared, worth):
    """In place of `with_streak`: every image is taken to have none."""
    return fits, good, shared


def test_headings_under_a_streak_are_as_good_as_reported(monkeypatch):
    """16 markers under 4 px: the mean of 16 squares has a standard deviation of sqrt(2 / 16) = 0.35. Fitted
    as round, the negative control, they are off by four times their standard deviation."""
    seen = score(11, 1, 1, motion_px=4.0, blur_px=0.8)
    assert seen.found == 16 and seen.false_positives_per_image == 0
    assert seen.nees_heading < 1 + 4 * 0.35
    assert max(seen.nees_u, seen.nees_v) < 1 + 4 * 0.35
    monkeypatch.setattr(measure, "with_streak", is_round)
    assert score(11, 1, 1, motion_px=4.0, blur_px=0.8).nees_heading > 1 + 8 * 0.35


def test_one_marker_gives_its_streak_with_a_covariance():
    """12 images of one marker under 3 px: the streak is known from that marker only."""
    seen = score(3, 2, 6, markers=1, motion_px=3.0, blur_px=0.8)
    assert seen.found == 12
    assert 0.2 < seen.nees_heading < 1 + 4 * (2 / 12) ** 0.5


@pytest.mark.parametrize("factors", [{}, {"tilt_deg": 20.0}, {"side_px": 12.0}, {"jpeg": 80}])
def test_images_without_a_streak_are_fitted_once(monkeypatch, factors):
    """No marker is fitted again, and so nothing changes; with a streak of 4 px they are."""
    called = []
    monkeypatch.setattr(refine, "fit_any_blur", lambda *args, **how: called.append(1) or 1 / 0)
    assert score(5, 2, 1, **factors).found >= 30
    assert not called
    with pytest.raises(ZeroDivisionError):
        score(5, 1, 1, **factors, motion_px=4.0)


def test_a_rise_of_the_residuals_ends_the_rounds(monkeypatch):
    """With a limit that no streak passes, one round is made, and the fits under round blur stay."""
    called, real = [], refine.fit_any_blur
    monkeypatch.setattr(refine, "fit_any_blur", lambda *given, **how: called.append(1) or real(*given, **how))
    under_streak = score(11, 1, 1, motion_px=4.0, blur_px=0.8)
    rounds = len(called)
    monkeypatch.setattr(refine, "HOPELESS_RISE", 0.0)
    ended = score(11, 1, 1, motion_px=4.0, blur_px=0.8)
    assert len(called) == rounds + 1
    monkeypatch.setattr(measure, "with_streak", is_round)
    assert ended == score(11, 1, 1, motion_px=4.0, blur_px=0.8) != under_streak


@pytest.mark.parametrize(("significance", "rounds"), [(0.9, 1), (1.1, refine.STREAK_ROUNDS)])
def test_rounds_end_with_a_change_within_its_standard_deviation(monkeypatch, significance, rounds):
    """Each round asks for a fifth more of the streak; without noise that would be worth another one."""

    def evidence(image, dictionary, fits, plane, noise, streak_px2):
        if not streak_px2:
            return streak_evidence(image, dictionary, fits, plane, noise, streak_px2)
        change = 0.2 * np.array([streak_px2.real, streak_px2.imag])
        information = significance / (change @ change)
        return StreakEvidence(information * np.eye(2)[None], information * change[None])

    called, fit, streak_evidence = [], refine.fit_any_blur, refine.streak_evidence
    monkeypatch.setattr(refine, "fit_any_blur", lambda *given, **how: called.append(1) or fit(*given, **how))
    monkeypatch.setattr(refine, "streak_evidence", evidence)
    score(11, 1, 1, motion_px=4.0, blur_px=0.8)
    assert len(called) == rounds


def test_a_streak_that_leaves_greater_residuals_is_not_taken(monkeypatch):
    """By 2 % after the last round, at which no limit ends the rounds and every fit is verified."""
    fit, with_streak, before = refine.fit_any_blur, measure.with_streak, dict[int, float]()

    def noted(image, dictionary, fits, *rest):
        before.update(zip(fits.ids.tolist(), fits.noise_stds.tolist(), strict=True))
        return with_streak(image, dictionary, fits, *rest)

    def worse(*given, **how):
        fits, plane = fit(*given, **how)
        return replace(
            fits, noise_stds=1.02 * np.array([before[marker] for marker in fits.ids.tolist()])
        ), plane

    under_streak = score(11, 1, 1, motion_px=4.0, blur_px=0.8)
    monkeypatch.setattr(measure, "with_streak", noted)
    monkeypatch.setattr(refine, "fit_any_blur", worse)
    refused = score(11, 1, 1, motion_px=4.0, blur_px=0.8)
    monkeypatch.setattr(measure, "with_streak", is_round)
    assert refused == score(11, 1, 1, motion_px=4.0, blur_px=0.8) != under_streak


@pytest.mark.parametrize("toward_rad", [0.3, 1.4, 2.6])
def test_the_streak_found_is_the_one_drawn(monkeypatch, place_markers, draw_markers, toward_rad):
    """Q = L² / 24 e^{2iφ} of 2 px, which another program draws: the mean of shifted images. A Gaussian takes
    a box of this length for 6 % more, since its flanks are longer."""
    found = []
    real = refine.fit_any_blur

    def noted(*args, **how):
        found.append(how["streak_px2"])
        return real(*args, **how)

    def smear(image):
        values = np.fft.fft2(image)
        for share in (np.arange(16) + 0.5) / 16 - 0.5:
            shift = 2.0 * share * np.array([np.sin(toward_rad), np.cos(toward_rad)])
            smeared.append(np.fft.ifft2(ndimage.fourier_shift(values, shift)).real)
        image[...] = np.mean(smeared, axis=0)

    smeared = []
    rng = np.random.default_rng(6)
    places = np.add.outer(1j * np.arange(60, 400, 90), np.arange(60, 400, 90)).ravel()
    matrices = place_markers(places, rng.uniform(-3, 3, 16), 30.0)
    image = draw_markers(matrices, range(16), (400, 400), rng, paint=smear)
    monkeypatch.setattr(refine, "fit_any_blur", noted)
    assert PhotometricDetector(DICTIONARY).detect(image).ids.tolist() == list(range(16))
    assert found[-1] == pytest.approx(4 / 24 * np.exp(2j * toward_rad), rel=0.12)


def test_a_steep_tilt_is_as_good_as_reported():
    """24 markers at 70 degrees. The controls are with the plane's iteration and with the drawing."""
    seen = score(1, 3, 2, tilt_deg=70.0, blur_px=1.0, noise=2.0)
    assert seen.found == 24 and seen.nees_heading < 1 + 4 * (2 / 24) ** 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    "factors",
    [
        {"motion_px": 1.0},
        {"motion_px": 2.0},
        {"motion_px": 4.0},
        {"tilt_deg": 50.0},
        {"tilt_deg": 60.0},
        {"tilt_deg": 70.0},
        {"occlusion": 0.02},
        {"occlusion": 0.05},
    ],
)
def test_covariances_hold_outside_of_the_clean_grid(factors):
    """Under streaks and at tilts: NEES of 0.8 to 1.25 for both axes and, if not covered, the heading.

    Of 500 markers at least, whose NEES has a standard deviation of 0.06. At 70 degrees an image has four,
    whose headings all depend on one plane, so that it takes twice as many images: 144, and 0.1.
    """
    cameras = 24 if factors.get("tilt_deg") == 70.0 else 12
    seen = score(31, cameras, 6, **factors)
    assert seen.found > 500 and seen.false_positives_per_image == 0
    assert 0.8 < seen.nees_u < 1.25 and 0.8 < seen.nees_v < 1.25
    if "occlusion" not in factors:
        assert 0.8 < seen.nees_heading < 1.25


@pytest.mark.slow
def test_without_a_margin_about_covers_headings_are_too_sure(monkeypatch):
    """The negative control of the margin: pixels at a cover's edge pull at the pose."""
    with_margin = score(31, 6, 6, occlusion=0.05).nees_heading
    monkeypatch.setattr(occlusion, "MARGIN_SIGMAS", 0.0)
    assert score(31, 6, 6, occlusion=0.05).nees_heading > 1.3 * with_margin


@pytest.mark.slow
def test_under_round_blur_headings_of_streaks_are_too_sure(monkeypatch):
    """The negative control of streaks."""
    monkeypatch.setattr(measure, "with_streak", is_round)
    assert score(31, 3, 4, motion_px=2.0).nees_heading > 1.5


def test_errors_of_headings_under_a_streak_keep_to_the_bound():
    """Root mean square over the bound's, of 32 markers: 1.14 in the mean, with a deviation of an eighth."""
    frames = list(rendered_frames(Cell(cameras=1, frames=2, motion_px=2.0, blur_px=1.0), DICTIONARY, 4))
    detector, ratios = PhotometricDetector(DICTIONARY, following=False), []
    for frame in frames:
        seen = detector.detect(frame.image)
        answers, rows = match(frame, seen)
        turn = wrap_angle(seen.headings_rad[answers] - frame.headings_rad[rows])
        ratios.append(turn**2 / frame.bounds[rows, 2, 2])
    assert np.sqrt(np.concatenate(ratios).mean()) < 1.14 + 4 / 8
