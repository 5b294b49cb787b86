"""`skyherd live check`: coverage, overlap, sizes, light and blur of drawn cameras, and the advice."""

import cv2
import numpy as np
import pytest
from command_line import call

from skyherd.live.cameras import Frame
from skyherd.live.lab import load_lab
from skyherd.live.lab.camera_survey import CameraSurvey, Level, team_findings
from skyherd.markers.dictionary import marker_cells
from skyherd.vision import create_detector, measure_marker_images

PLACES = {0: (150, 120), 1: (500, 120), 2: (150, 360), 3: (500, 360)}
"""Usual centres of the markers, px."""


def picture(places=PLACES, *, cell_px=6, sigma_px=0.8, streak_px=0, black=40, white=200, size_px=(640, 480)):
    """Return an image of markers whose blur is Gaussian, and uniform along u over `streak_px`.

    It is drawn at four times the size, so that edges are those of a pixel's area.
    """
    image = np.full((4 * size_px[1], 4 * size_px[0]), (black + white) / 2, np.float32)
    for marker, (u, v) in places.items():
        cells = np.pad(marker_cells("4X4_50", marker), 1, constant_values=True)
        card = np.kron(np.where(cells, white, black), np.ones((4 * cell_px, 4 * cell_px)))
        top, left = 4 * v - card.shape[0] // 2, 4 * u - card.shape[1] // 2
        image[top : top + card.shape[0], left : left + card.shape[1]] = card
    image = cv2.GaussianBlur(image, (0, 0), 4 * sigma_px)
    if streak_px:
        image = cv2.blur(image, (4 * streak_px, 1))
    image = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
    image += np.random.default_rng(0).normal(size=image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def survey_of(pictures, *settings, rate_hz=10.0, lab="table"):
    """Return a survey of images at a rate."""
    survey = CameraSurvey(load_lab(lab, settings))
    detector = create_detector("photometric", dictionary="4X4_50")
    for number, image in enumerate(pictures):
        time_s = number / rate_hz
        survey.add(Frame(image, time_s, time_s, number, "stream"), detector.detect(image, time_s=time_s))
    return survey


def advice(survey) -> str:
    """Return the findings that are not good, in one text."""
    return "\n".join(f"{one.level}: {one.text}" for one in survey.findings() if one.level is not Level.GOOD)


@pytest.mark.parametrize("sigma_px", [0.6, 1.5, 3.0])
def test_blur_and_light_are_those_of_the_drawing(sigma_px) -> None:
    """A pixel's area adds 1/12 px². The bound of 5 % is that of the detector's steps between blurs."""
    image = picture(sigma_px=sigma_px, cell_px=8)
    found = create_detector("photometric", dictionary="4X4_50").detect(image)
    images = measure_marker_images(image, found, "4X4_50")
    assert len(found) == 4
    np.testing.assert_allclose(images.blurs_cells, np.hypot(sigma_px, 12**-0.5) / 8, rtol=0.05)
    np.testing.assert_allclose(images.blacks, 40, atol=2)
    np.testing.assert_allclose(images.whites, 200, atol=2)


def test_good_camera_needs_no_advice() -> None:
    survey = survey_of([picture()] * 3)
    assert advice(survey) == "" and survey.is_fine
    said = "\n".join(one.text for one in survey.findings())
    assert "robots 0, 1, 2, 3 of 4 seen" in said and "markers 36 to 36 px wide" in said
    assert list(team_findings(survey.lab, [set(survey.seen)])) == []


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (picture(cell_px=3, sigma_px=0.5), "advice: markers 18 to 18 px wide (limit 12): move the camera"),
        (picture(black=20, white=70), "advice: black 20, white 70 of 255: add light"),
        (picture(black=60, white=262), "overexposed; shorten the exposure"),
        (picture(sigma_px=3.6), "(limit 0.75): focus the camera"),
        (picture(PLACES | {3: (600, 360)}), "advice: markers 3 are near the border"),
        (picture({0: PLACES[0]}), ""),
        (picture({}), "problem: no robot seen: check aim, focus and light"),
    ],
    ids=["small", "dark", "bright", "blurred", "border", "one", "none"],
)
def test_each_defect_has_its_advice(image, said) -> None:
    assert said in advice(survey_of([image] * 3))


def moving(streak_px: int) -> list[np.ndarray]:
    """Return five images of two markers, the upper of which moves with a streak; cells are 8 px wide."""
    still = picture({1: (300, 360)}, cell_px=8, sigma_px=0.5)
    images = [
        picture({0: (150 + 32 * k, 120)}, streak_px=streak_px, cell_px=8, sigma_px=0.5) for k in range(5)
    ]
    return [np.concatenate([image[:240], still[240:]]) for image in images]


def test_motion_blur_is_told_from_focus() -> None:
    """Streaks of 0.4 cells need no advice, and those of 1.2 cells do. Beyond 1.5 it is lost."""
    assert "shorten the exposure" not in advice(survey_of(moving(3)))
    said = advice(survey_of(moving(10)))
    assert "moving (limit 0.75): shorten the exposure, and add light" in said
    assert set(survey_of(moving(20)).seen) == {1} and set(survey_of(moving(12)).seen) == {0, 1}


def test_longest_exposure_is_one_and_a_half_cells() -> None:
    """A cell of the table's markers is 80/6 mm wide; at 5 m/s it is crossed in 2.7 ms."""
    said = advice(survey_of([picture()] * 3, "limits.max_speed_mps=5"))
    assert "an exposure of up to 4 ms keeps markers legible, less than between" in said


def test_slow_camera_is_too_slow_for_the_timeout() -> None:
    assert "too few for goal_timeout_s = 0.6" in advice(survey_of([picture()] * 3, rate_hz=4.0))


def test_shape_larger_than_the_image_is_told() -> None:
    """A square of ten sides of 36 px needs 2 (sqrt(0.5) 10 + 1) 36 = 581 px; the image has 480."""
    said = advice(survey_of([picture()] * 3, "shape.size={spacing_sides=10.0}"))
    assert "the shape needs a circle of 0.65 m around the robots" in said and "out of view" in said


def test_overlap_and_lost_robots_are_told_for_the_team() -> None:
    left = survey_of([picture({0: PLACES[0], 1: PLACES[1]})] * 2, lab="webcams")
    right = survey_of([picture({1: PLACES[1], 2: PLACES[2]})] * 2, lab="webcams")
    said = [f"{one.level}: {one.text}" for one in team_findings(left.lab, [set(left.seen), set(right.seen)])]
    assert said[0].startswith("problem: robots 3 seen by no camera")
    assert said[1] == "ok: cameras 0 and 1 share robots 1"
    assert said[2].startswith("advice: camera 1 shares fewer than 2 robots")
    both = survey_of([picture({0: PLACES[0], 1: PLACES[1], 3: PLACES[3]})] * 2, lab="webcams")
    levels = [one.level for one in team_findings(left.lab, [set(left.seen), set(both.seen)])]
    assert levels == [Level.PROBLEM, Level.GOOD]


def test_verb_watches_a_folder_of_images(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "video").mkdir()
    from skyherd.files.video_writer import VideoSink

    with VideoSink(tmp_path / "table.mp4", (640, 480), 10) as sink:
        for _ in range(10):
            sink.write(np.repeat(picture()[..., None], 3, axis=2))
    settings = ["--set", f"cameras.0.address='{tmp_path / 'table.mp4'}'", "--seconds", "0.5"]
    code, out, err = call(capsys, "live", "check", "table", *settings)
    assert (code, err) == (0, "") and "  ok      robots 0, 1, 2, 3 of 4 seen" in out
    assert out.splitlines()[-1] == "table: good: 4 robots, 1 camera(s)"
