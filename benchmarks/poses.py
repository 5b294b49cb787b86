"""Measure poses of markers on rendered images: consistency of covariances, and errors beside OpenCV's.

```sh
python benchmarks/poses.py --picture docs/poses.png    # docs/how-to/poses.md
python benchmarks/poses.py --images 1 --sides 40 --tilts 0,40
```

Each image shows up to nine markers of 4X4_50 with random headings on one textured plane, with noise 2 and
blur 0.8 px. The truth is exact. NEES is `eᵀ C⁻¹ e / 6` of the six errors.

- `alone` is `marker_poses` of single markers; `coplanar` is `common_frame` of all of them on one plane.
- `IPPE` is OpenCV's solvePnP (IPPE_SQUARE) on the detector's corners, and on those of OpenCV's detector.
- Positions are RMS in per mille of the distance, rotations in degrees.
"""

import argparse
from pathlib import Path

import cv2
import numpy as np
from command import numbers, run
from matplotlib.figure import Figure

from skyherd.geometry import Array, IntArray, apply_homography, inverse
from skyherd.messages import Detections
from skyherd.plots.style import drawing_style
from skyherd.poses import Calibration, View, common_frame, marker_poses
from skyherd.poses.marker_poses import pose_difference
from skyherd.render import Camera, CameraPose, Distortion, Equidistant, Ground, Renderer, Sensor, Shot
from skyherd.render.camera.camera import homography_image_ground, rotation_camera_world, undistort
from skyherd.vision import create_detector, measure_outlines

SIDES_PX, TILTS_DEG = (20.0, 40.0, 80.0), (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
SIZE_PX, SPACING = (800, 640), 2.3
# No card, of 4 / 3 of a side and any heading, covers another marker.
MIN_DISTANCE = 1.65
LENSES = {
    "pinhole, f 1000 px": (1000.0, None),
    "pinhole, f 400 px": (400.0, None),
    "Brown-Conrady, k1 -0.3": (700.0, Distortion(k1=-0.3, k2=0.1, p1=0.001)),
    "fisheye, f 450 px": (450.0, Equidistant()),
}
NAMES = ("alone", "coplanar", "IPPE", "IPPE, OpenCV")
CERTAIN = float(np.log(100.0))
SQUARE = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])
FORWARD_LEFT = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def calibration_of(camera: Camera) -> Calibration:
    """Return the calibration of a rendered camera, with OpenCV's coefficients."""
    lens = camera.distortion
    fisheye = isinstance(lens, Equidistant)
    coefficients = np.zeros(4) if fisheye else np.array([lens.k1, lens.k2, lens.p1, lens.p2, lens.k3])
    return Calibration(camera.size_px, camera.intrinsic_matrix(), coefficients, fisheye)


def scene(
    side_px: float, tilt_deg: float, focal_px: float, lens, rng: np.random.Generator
) -> tuple[Renderer, Shot]:
    """Return a renderer, and a shot of nine markers of side 1 m whose sides are `side_px` in the middle."""
    camera = Camera(SIZE_PX, focal_px=focal_px, **({} if lens is None else {"distortion": lens}))
    tilt, azimuth = np.radians(tilt_deg), rng.uniform(-np.pi, np.pi)
    height = focal_px / side_px * np.cos(tilt)
    pose = CameraPose(
        (0.0, 0.0), height, rng.uniform(-np.pi, np.pi), (tilt * np.cos(azimuth), tilt * np.sin(azimuth))
    )
    grid = np.stack(np.meshgrid(*[np.arange(3) - 1.0] * 2), axis=-1).reshape(-1, 2)
    pixels = (np.array(SIZE_PX) - 1) / 2 + side_px * (SPACING * grid + rng.uniform(-0.3, 0.3, (9, 2)))
    straight = undistort(camera, 1.0, pixels)
    positions = apply_homography(inverse(homography_image_ground(camera, pose)), straight)
    away = np.linalg.norm(positions[:, None] - positions, axis=2)
    kept = np.array([not (row[:k] < MIN_DISTANCE).any() for k, row in enumerate(away)])
    headings = rng.uniform(-np.pi, np.pi, 9)
    renderer = Renderer("4X4_50", 1.0, Ground(int(rng.integers(1000))), Sensor(2.0, rng), psf_px=0.8)
    ids = np.sort(rng.permutation(50)[:9])
    return renderer, Shot(camera, pose, ids[kept], positions[kept], headings[kept])


def truth(shot: Shot) -> dict[int, tuple[Array, Array]]:
    """Return the exact poses of the markers in the camera's axes, by id."""
    to_camera = rotation_camera_world(shot.pose)
    center = np.array([*shot.pose.position_m, shot.pose.height_m])
    poses = {}
    for marker, place, heading in zip(shot.ids.tolist(), shot.positions_m, shot.headings_rad, strict=True):
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        poses[marker] = to_camera @ turn, to_camera @ (np.array([*place, 0.0]) - center)
    return poses


def by_ippe(ids: IntArray, corners_px: Array, calibration: Calibration) -> dict[int, tuple[Array, Array]]:
    """Return the poses of OpenCV's solvePnP, by id."""
    poses = {}
    for marker, corners in zip(ids.tolist(), corners_px, strict=True):
        # OpenCV's solvePnP takes a fisheye's corners as rays.
        given = (calibration.rays(corners), np.eye(3), None) if calibration.fisheye else (
            corners, calibration.matrix, calibration.coefficients)  # fmt: skip
        _, turn, shift = cv2.solvePnP(SQUARE, *given, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        if np.isfinite(turn).all():  # none of exactly frontal corners
            poses[marker] = cv2.Rodrigues(turn)[0] @ FORWARD_LEFT.T, shift.ravel()
    return poses


class Cell:
    """Errors and NEES of the markers of one tilt and side."""

    def __init__(self) -> None:
        self.errors: dict[str, list[Array]] = {name: [] for name in NAMES}
        self.nees: dict[str, list[float]] = {name: [] for name in NAMES[:2]}
        self.markers = self.certain = self.wrong = 0

    def add(self, image, shot: Shot, found: Detections, opencv: dict[int, Array]) -> None:
        """Add the markers that both detectors found in one image."""
        calibration, true = calibration_of(shot.camera), truth(shot)
        found = found.select([marker for marker in found.ids.tolist() if marker in true and marker in opencv])
        if not len(found):
            return
        corners, covariances = measure_outlines(image, found, "4X4_50")
        alone = marker_poses(corners, covariances, calibration, 1.0)
        frame = common_frame(
            [View("image", calibration, found.ids, corners, covariances)], 1.0, coplanar=True
        )
        turns, shifts, joint = frame.in_camera(0)
        rows = np.searchsorted(frame.ids, found.ids)
        ippe = by_ippe(found.ids, found.corners_px, calibration)
        plain = by_ippe(found.ids, np.array([opencv[marker] for marker in found.ids.tolist()]), calibration)
        for k, marker in enumerate(found.ids.tolist()):
            poses = {
                "alone": (alone.rotations[k], alone.translations_m[k]),
                "coplanar": (turns[rows[k]], shifts[rows[k]]),
                "IPPE": ippe.get(marker),
                "IPPE, OpenCV": plain.get(marker),
            }
            offs = {name: pose_difference(*one, *true[marker]) for name, one in poses.items() if one}
            distance = float(np.linalg.norm(true[marker][1]))
            for name, off in offs.items():
                self.errors[name].append(np.array([*off[:3] / distance, *off[3:]]))
            other = pose_difference(alone.other_rotations[k], alone.other_translations_m[k], *true[marker])
            self.markers += 1
            self.wrong += bool(np.linalg.norm(other[3:]) < np.linalg.norm(offs["alone"][3:]) - 1e-9)
            if alone.log_ratios[k] > CERTAIN:
                self.certain += 1
                self.nees["alone"].append(
                    offs["alone"] @ np.linalg.solve(alone.covariances[k], offs["alone"]) / 6
                )
            self.nees["coplanar"].append(
                offs["coplanar"] @ np.linalg.solve(joint[rows[k]], offs["coplanar"]) / 6
            )

    def rms(self, name: str) -> tuple[float, float]:
        """Return the RMS errors of positions, per mille of the distance, and of rotations, degrees."""
        squares = np.mean(np.square(self.errors[name]), axis=0)
        return 1e3 * float(np.sqrt(squares[:3].sum())), float(np.degrees(np.sqrt(squares[3:].sum())))


def measure(side_px: float, tilt_deg: float, lens_name: str, images: int, seed: int) -> Cell:
    cell, detector = Cell(), create_detector("photometric", dictionary="4X4_50")
    aruco = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    for number in range(images):
        rng = np.random.default_rng(
            [seed, number, int(side_px), int(tilt_deg), list(LENSES).index(lens_name)]
        )
        renderer, shot = scene(side_px, tilt_deg, *LENSES[lens_name], rng)
        image = renderer.render(shot)
        corners, ids, _ = aruco.detectMarkers(image)
        opencv = (
            {}
            if ids is None
            else dict(zip(np.ravel(ids).tolist(), np.reshape(corners, (-1, 4, 2)), strict=True))
        )
        cell.add(image, shot, detector.detect(image), {k: v.astype(float) for k, v in opencv.items()})
    return cell


HEADS = ["lens", "side, px", "tilt, deg", "markers", "certain", "wrong", "NEES alone", "NEES coplanar"]


def row(lens: str, side_px: float, tilt_deg: float, cell: Cell) -> str:
    """Return a line of the table: counts, NEES and errors."""
    if not cell.markers:
        return f"| {lens} | {side_px:.0f} | {tilt_deg:.0f} | 0 |" + " |" * (2 * len(NAMES) + 4)
    errors = [cell.rms(name) for name in NAMES]
    counts = [lens, f"{side_px:.0f}", f"{tilt_deg:.0f}", *map(str, (cell.markers, cell.certain, cell.wrong))]
    nees = [f"{np.mean(cell.nees[name]):.2f}" if cell.nees[name] else "–" for name in NAMES[:2]]
    return (
        "| "
        + " | ".join([*counts, *nees, *(f"{x:.3g}" for pair in zip(*errors, strict=True) for x in pair)])
        + " |"
    )


def draw(cells: dict[tuple[float, float], Cell], path: Path) -> None:
    """Draw errors by tilt for each side, and NEES."""
    with drawing_style():
        figure = Figure(figsize=(7.2, 4.6))
        sides = sorted({side for side, _ in cells})
        axes = figure.subplots(2, len(sides), sharey="row", sharex=True, squeeze=False)
        for column, side in enumerate(sides):
            tilts = sorted(tilt for s, tilt in cells if s == side)
            for name, mark in zip(NAMES, ("o-", "s-", "^--", "v:"), strict=True):
                values = [cells[side, tilt].rms(name)[1] for tilt in tilts]
                axes[0, column].semilogy(tilts, values, mark, markersize=3, label=name)
            for name, mark in zip(NAMES[:2], ("o-", "s-"), strict=True):
                axes[1, column].plot(
                    tilts, [np.mean(cells[side, tilt].nees[name]) for tilt in tilts], mark, markersize=3
                )
            axes[1, column].axhspan(0.8, 1.25, color="0.85", zorder=0)
            axes[0, column].set_title(f"{side:.0f} px")
            axes[1, column].set(xlabel="tilt (deg)", ylim=(0, 2))
        axes[0, 0].set_ylabel("rotation error, RMS (deg)")
        axes[1, 0].set_ylabel("NEES / 6")
        axes[0, -1].legend(fontsize=6)
        figure.tight_layout()
        figure.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--images", type=int, default=8, help="images a cell, nine markers each")
    parser.add_argument("--sides", type=numbers, default=SIDES_PX)
    parser.add_argument("--tilts", type=numbers, default=TILTS_DEG)
    parser.add_argument(
        "--lenses", default="0", help="numbers of the lenses: 0 pinhole, 1 short, 2 bent, 3 fisheye"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--table", type=Path)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    heads = HEADS + [f"{what} {name}" for what in ("position", "rotation") for name in NAMES]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    print("\n".join(lines), flush=True)
    cells = {}
    for lens in (list(LENSES)[int(k)] for k in given.lenses.split(",")):
        for side in given.sides:
            for tilt in given.tilts:
                cell = measure(side, tilt, lens, given.images, given.seed)
                cells[side, tilt] = cell
                lines.append(row(lens, side, tilt, cell))
                print(lines[-1], flush=True)
    if given.table:
        given.table.write_text("\n".join(lines) + "\n", "utf-8")
    if given.picture:
        draw(cells, given.picture)


if __name__ == "__main__":
    run(main)
