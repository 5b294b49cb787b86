"""Calibration files of other programs: what is read, and one line for what is not."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.poses import Calibration, read_calibration

MATRIX = np.array([[700.5, 0.0, 320.25], [0.0, 701.5, 240.75], [0.0, 0.0, 1.0]])
PLUMB_BOB = np.array([-0.3, 0.1, 0.001, -0.002, 0.01])
FISHEYE = np.array([0.05, -0.01, 0.003, -0.001])

ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [700.5, 0, 320.25, 0, 701.5, 240.75, 0, 0, 1]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: {values}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}
"""

KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [700.5, 701.5, 320.25, 240.75]
  distortion_model: {model}
  distortion_coeffs: {values}
  resolution: [640, 480]
  T_cam_imu:
  - [1.0, 0.0, 0.0, 0.0]
"""

CALISCOPE = """[{table}.3]
port = 3
size = [640, 480]
rotation_count = 0
matrix = [[700.5, 0.0, 320.25], [0.0, 701.5, 240.75], [0.0, 0.0, 1.0]]
distortions = {values}
fisheye = {fisheye}
translation = [0.0, 0.0, 1.0]
"""


def ros(model, values):
    return ROS.format(model=model, count=len(values), values=list(values))


def caliscope(values, fisheye):
    return CALISCOPE.format(table="cameras", values=values.tolist(), fisheye=fisheye)


FILES = {
    "ros.yaml": (ros("plumb_bob", PLUMB_BOB.tolist()), PLUMB_BOB, False),
    "rational.yaml": (ros("rational_polynomial", [0.1] * 8), np.full(8, 0.1), False),
    "ros-fisheye.yaml": (ros("equidistant", FISHEYE.tolist()), FISHEYE, True),
    "kalibr.yaml": (KALIBR.format(model="radtan", values=[-0.3, 0.1, 0.001, -0.002]), PLUMB_BOB[:4], False),
    "kalibr-fisheye.yaml": (KALIBR.format(model="equidistant", values=FISHEYE.tolist()), FISHEYE, True),
    "pinhole.yaml": (KALIBR.format(model="none", values=[]), np.zeros(0), False),
    "caliscope.toml": (caliscope(PLUMB_BOB, "false"), PLUMB_BOB, False),
    "caliscope-fisheye.toml": (caliscope(FISHEYE, "true"), FISHEYE, True),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_calibration_of_each_form_is_read(tmp_path, name) -> None:
    text, coefficients, fisheye = FILES[name]
    (tmp_path / name).write_text(text)
    found = read_calibration(tmp_path / name)
    assert found.size_px == (640, 480) and found.fisheye is fisheye
    np.testing.assert_array_equal(found.matrix, MATRIX)
    np.testing.assert_array_equal(found.coefficients, coefficients)


def test_file_that_opencv_writes_is_read(tmp_path) -> None:
    path = tmp_path / "camera.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", MATRIX)
    storage.write("distortion_coefficients", PLUMB_BOB.reshape(1, 5))
    storage.release()
    found = read_calibration(path)
    assert found.size_px == (640, 480) and not found.fisheye
    np.testing.assert_array_equal(found.matrix, MATRIX)
    np.testing.assert_array_equal(found.coefficients, PLUMB_BOB)


def test_one_of_several_cameras_is_chosen_by_name(tmp_path) -> None:
    one = KALIBR.format(model="none", values=[])
    path = tmp_path / "chain.yaml"
    path.write_text(one + one.replace("cam0", "cam1").replace("700.5", "800.5"))
    assert read_calibration(f"{path}#cam1").matrix[0, 0] == 800.5
    with pytest.raises(InputError, match="2 cameras; one of"):
        read_calibration(path)
    with pytest.raises(InputError, match="no camera 'cam7'"):
        read_calibration(f"{path}#cam7")


@pytest.mark.parametrize("name", ["ros.yaml", "caliscope.toml"])
def test_file_with_a_byte_order_mark_is_calibration(tmp_path, name) -> None:
    (tmp_path / name).write_text(FILES[name][0], "utf-8-sig")
    assert read_calibration(tmp_path / name).size_px == (640, 480)


def test_name_is_rejected_if_the_only_camera_has_none(tmp_path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(GOOD)
    with pytest.raises(InputError) as error:
        read_calibration(f"{path}#cam3")
    unnamed = "no camera 'cam3', since its only camera has no name"
    assert str(error.value) == f"{path}: {unnamed}; leave out '#cam3'"


GOOD = ros("plumb_bob", [0.0] * 5)
BAD = {
    "nothing": ("", "no keys and values"),
    "text": ("only words", "no keys and values"),
    "list": ("[1, 2]", "no keys and values"),
    "other keys": ("a: 1\nb: 2", "no camera in it"),
    "not yaml": ("camera_matrix: [1, 2", "damaged"),
    "deep": ("[" * 100_000, "damaged"),
    "unknown tag": ("camera_matrix: !!python/object/apply:os.system ['true']", "damaged"),
    "unknown model": (GOOD.replace("plumb_bob", "plum_bob"), "plumb_bob"),
    "three numbers": (ros("plumb_bob", [0.1] * 3), "3 numbers"),
    "fisheye of five": (ros("equidistant", [0.1] * 5), "5 numbers"),
    "not a number": (GOOD.replace("701.5", ".nan"), "finite numbers"),
    "words in the matrix": (GOOD.replace("701.5", "abc"), "finite numbers"),
    "huge number": (GOOD.replace("701.5", "1e999"), "finite numbers"),
    "short matrix": (GOOD.replace("700.5, 0, ", ""), "7 numbers"),
    "negative focal length": (GOOD.replace("700.5", "-700.5"), "fx and fy above 0"),
    "skew": (GOOD.replace("700.5, 0,", "700.5, 3,"), "camera matrix"),
    "no image": (GOOD.replace("640", "0"), "image size"),
    "half a pixel": (GOOD.replace("640", "640.5"), "width and height"),
    "no height": (GOOD.replace("image_height", "image_hight"), "image size"),
    "omnidirectional": (KALIBR.format(model="none", values=[]).replace("pinhole", "omni"), "pinhole"),
    "five intrinsics": (KALIBR.format(model="none", values=[]).replace("[700.5,", "[1, 700.5,"), "5 numbers"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_file_is_one_line(tmp_path, name) -> None:
    text, why = BAD[name]
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_calibration(path)
    assert why in str(error.value) and "camera.yaml" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["absent.yaml", "camera.json", "", "."])
def test_path_without_calibration_is_one_line(tmp_path, name) -> None:
    with pytest.raises(InputError, match=r"calibration file|no such file"):
        read_calibration(tmp_path / name if name else Path(name))


def test_bad_toml_and_binary_files_are_one_line(tmp_path) -> None:
    for name, data in (("a.toml", b"[cameras\n"), ("b.toml", b"x = 1"), ("c.yaml", b"\xff\xfe\x00")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match=name):
            read_calibration(tmp_path / name)


def test_projection_is_inverted_by_rays() -> None:
    points = np.random.default_rng(1).normal(size=(7, 3)) * [0.3, 0.3, 0.0] + [0, 0, 1.5]
    for coefficients, fisheye in ((np.zeros(0), False), (PLUMB_BOB, False), (FISHEYE, True)):
        calibration = Calibration((640, 480), MATRIX, coefficients, fisheye)
        rays = calibration.rays(calibration.project(points))
        np.testing.assert_allclose(rays, points[:, :2] / points[:, 2:], atol=1e-5)
        step = 1e-6
        slopes = [
            (calibration.project(points + step * axis) - calibration.project(points - step * axis))
            / (2 * step)
            for axis in np.eye(3)
        ]
        np.testing.assert_allclose(calibration.jacobians(points), np.stack(slopes, axis=-1), atol=1e-3)


def test_image_of_another_size_is_one_line() -> None:
    calibration = Calibration((640, 480), MATRIX, PLUMB_BOB)
    calibration.check_image("a.png", (640, 480))
    with pytest.raises(InputError, match=r"a\.png: 320 x 240 px, calibrated at 640 x 480"):
        calibration.check_image("a.png", (320, 240))
