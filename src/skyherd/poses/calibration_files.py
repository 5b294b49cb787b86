"""Calibration files of other programs: OpenCV and ROS YAML, Kalibr YAML, and caliscope TOML.

| file | matrix | distortion | size |
|---|---|---|---|
| OpenCV | `camera_matrix`, `K` | `distortion_coefficients`, `D`; `fisheye_model` | `image_width` … |
| ROS | `camera_matrix`, `K` | the same; `distortion_model` | `image_width` or `width` … |
| Kalibr, `cam0` … | `intrinsics` | `distortion_coeffs`; `distortion_model` | `resolution` |
| caliscope, `[cameras.0]`, `[cam_0]` … | `matrix` | `distortions`; `fisheye` | `size` |

A file of several cameras needs a name after `#`: `camchain.yaml#cam1`.
"""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from skyherd.errors import InputError
from skyherd.files.reading import MIB, read_text
from skyherd.geometry import Array
from skyherd.messages.checks import shown
from skyherd.poses.calibration import Calibration
from skyherd.text import one_of

SUFFIXES = (".yaml", ".yml", ".toml")
"""Suffixes of calibration files."""

ALLOWED = "a calibration file: OpenCV, ROS or Kalibr .yaml, caliscope .toml"
"""Allowed files, as errors name them."""

MAX_BYTES = 4 * MIB
"""Maximum size of a calibration file. Chosen: thousands of cameras."""

FISHEYE = {
    "plumb_bob": False,
    "rational_polynomial": False,
    "radtan": False,
    "none": False,
    "equidistant": True,
    "fisheye": True,
    "kannala_brandt": True,
}
"""Whether a distortion model is Kannala–Brandt's, by its name in files of ROS and Kalibr."""

MATRIX_KEYS = ("camera_matrix", "K", "k", "cameraMatrix", "Camera_Matrix")
COEFFICIENT_KEYS = (
    "distortion_coefficients",
    "D",
    "d",
    "distCoeffs",
    "Distortion_Coefficients",
    "dist_coeffs",
)
WIDTH_KEYS, HEIGHT_KEYS = ("image_width", "width", "image_Width"), ("image_height", "height", "image_Height")
"""Keys of one value in files of OpenCV and ROS, the usual ones first."""

Table = Mapping[str, Any]
"""Keys and values of one camera or of a file."""


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """Loader of plain YAML, and of OpenCV's matrices as mappings."""


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
)


def read_calibration(where: Path | str) -> Calibration:
    """Read the calibration of one camera.

    Args:
        where: a file, with `#NAME` after it for one of several cameras.

    Raises:
        InputError: the file cannot be read, is of no known form, or has no such camera.
    """
    path, _, name = str(where).partition("#")
    file = Path(path)
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(path, f"suffix {file.suffix!r}", ALLOWED)
    cameras = _cameras(path, _parsed(file))
    if name and "" in cameras:
        unnamed = f"no camera {shown(name)}, since its only camera has no name"
        raise InputError(path, unnamed, f"leave out {shown(f'#{name}')}")
    if name and name not in cameras:
        raise InputError(path, f"no camera {shown(name)}", one_of(name, cameras))
    if not name and len(cameras) > 1:
        raise InputError(path, f"{len(cameras)} cameras", f"one of {path}#{', #'.join(cameras)}")
    name = name or next(iter(cameras))
    return calibration_of(f"{path}#{name}" if name else path, cameras[name])


def calibration_of(where: str, values: Table) -> Calibration:
    """Return the calibration of one camera, by the keys that a file or a `sensor_msgs/CameraInfo` has.

    Raises:
        InputError: a value is missing or invalid; `where` names its source.
    """
    try:
        return _calibration(values)
    except InputError as error:
        raise error.within(where) from None


def _parsed(file: Path) -> Table:
    """Return the content of a TOML or YAML file as a mapping."""
    text = read_text(file, ALLOWED, MAX_BYTES)
    try:
        if file.suffix.lower() == ".toml":
            found: Any = tomllib.loads(text)
        else:
            # OpenCV's first line, `%YAML:1.0`, is no directive of YAML.
            lines = text.splitlines()
            found = yaml.load("\n".join(lines[lines[:1] != [] and lines[0].startswith("%YAML:") :]), _Loader)
    except (tomllib.TOMLDecodeError, yaml.YAMLError, ValueError, RecursionError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise InputError(str(file), f"damaged: {why}", ALLOWED) from None
    if not isinstance(found, dict):
        raise InputError(str(file), "no keys and values", ALLOWED)
    return {str(key): value for key, value in found.items()}


def _cameras(path: str, content: Table) -> dict[str, Table]:
    """Return the cameras of a file by name; of a file of one camera without a name, by an empty one."""
    if _first(content, MATRIX_KEYS) is not None:
        return {"": content}
    inner = content.get("cameras")
    tables = inner if isinstance(inner, dict) else content
    cameras: dict[str, Table] = {
        str(name): {str(key): value for key, value in table.items()}
        for name, table in tables.items()
        if isinstance(table, dict) and ("matrix" in table or "intrinsics" in table)
    }
    if not cameras:
        keys = ", ".join(list(content)[:8]) or "nothing"
        raise InputError(path, f"no camera in it, only {shown(keys)}", ALLOWED)
    return cameras


def _calibration(camera: Table) -> Calibration:
    """Return the calibration by the keys of one camera, of whichever form."""
    if "intrinsics" in camera:
        return _kalibr(camera)
    if "matrix" in camera:
        return _made(
            camera.get("size"),
            camera["matrix"],
            camera.get("distortions", []),
            bool(camera.get("fisheye", False)),
        )
    size = [_first(camera, keys) for keys in (WIDTH_KEYS, HEIGHT_KEYS)]
    model = camera.get("distortion_model")
    fisheye = bool(camera.get("fisheye_model", 0)) if model in (None, "") else _is_fisheye(model)
    coefficients = _first(camera, COEFFICIENT_KEYS)
    return _made(
        None if size == [None, None] else size,
        _first(camera, MATRIX_KEYS),
        [] if coefficients is None else coefficients,
        fisheye,
    )


def _kalibr(camera: Table) -> Calibration:
    kind = camera.get("camera_model", "pinhole")
    if kind != "pinhole":
        raise InputError("camera_model", shown(kind), "pinhole")
    focal = _numbers("intrinsics", camera["intrinsics"])
    if focal.size != 4:
        raise InputError("intrinsics", f"{focal.size} numbers", "fx, fy, cx, cy")
    matrix = np.array([[focal[0], 0, focal[2]], [0, focal[1], focal[3]], [0, 0, 1]])
    fisheye = _is_fisheye(camera.get("distortion_model", "none"))
    return _made(camera.get("resolution"), matrix.tolist(), camera.get("distortion_coeffs", []), fisheye)


def _is_fisheye(model: Any) -> bool:
    if not isinstance(model, str) or model.lower() not in FISHEYE:
        raise InputError("distortion_model", shown(model), one_of(str(model), list(FISHEYE)))
    return FISHEYE[model.lower()]


def _made(size: Any, matrix: Any, coefficients: Any, fisheye: bool) -> Calibration:
    """Return a calibration of values as a file has them."""
    values = _numbers("distortion coefficients", coefficients)
    size_px = None if size is None else _numbers("image size", size)
    if size_px is not None and (size_px.size != 2 or (size_px != np.floor(size_px)).any()):
        raise InputError("image size", shown(size), "width and height, px")
    nine = _numbers("camera matrix", matrix)
    if nine.size != 9:
        raise InputError("camera matrix", f"{nine.size} numbers", "nine")
    # A pinhole is often written with coefficients of zero.
    values = np.zeros(4 if fisheye else 0) if not values.any() else values
    sides = None if size_px is None else (int(size_px[0]), int(size_px[1]))
    return Calibration(sides, nine.reshape(3, 3), values, fisheye)


def _numbers(where: str, value: Any) -> Array:
    """Return the numbers of a list, of nested lists, or of a mapping with `data`, in a row."""
    value = value.get("data") if isinstance(value, dict) else value
    try:
        numbers = np.array(value, dtype=float).ravel()
        if not isinstance(value, list) or not np.isfinite(numbers).all():
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise InputError(where, shown(value), "a list of finite numbers") from None
    return numbers


def _first(table: Table, keys: tuple[str, ...]) -> Any:
    return next((table[key] for key in keys if key in table), None)
