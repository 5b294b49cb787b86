"""Make the moving pictures and the replays of the home page, and README's, from runs of built-in scenarios.

Usage:

```
python docs/scripts/gallery.py               # all: runs the scenarios in a temporary folder, six minutes
python docs/scripts/gallery.py star letters  # these two
python docs/scripts/gallery.py --runs runs   # from runs/star/video.mp4 and so on, without running again
```
"""

import argparse
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from make_gif import hold_still, pick_frames, save_gif
from PIL import Image

from skyherd.files.video_writer import count_frames
from skyherd.play.replay import replay_data
from skyherd.recording.reader import read_recording
from skyherd.report.run_page import PHONE_VIDEO, VIDEO
from skyherd.runner import RECORDING

DOCS = Path(__file__).parent.parent
FOLDER = DOCS / "gallery"
RATE_HZ = 20
WIDTH_PX, PHONE_WIDTH_PX = 960, 520
"""Widths of a film, and of the one for phones. Chosen: twice the width of its card on the home page, as
displays of fine pixels need, and that of the run's film for phones."""
ENCODER = {"preset": "veryslow", "tune": "animation", "movflags": "+faststart"}
WIDE_CRF, PHONE_CRF = 30, 34
"""Settings of libx264, and rate factors. Chosen: labels stay legible, and a film of 12 s has about 0.6 MB."""
MAX_TOTAL_MB = 6.0
"""Largest size of all films and posters for one kind of screen. Chosen: what loads in a few seconds."""
MAX_REPLAY_MB = 1.5
"""Largest size of a replay. Chosen: twice that of viser's client, which a reader loads with the first one."""


@dataclass(frozen=True)
class Film:
    """The part of a run's video that a film shows.

    Attributes:
        frames: number of frames of the film, at most.
        share: part of the run's video, from its start; the last frame is the poster.
    """

    frames: int
    share: float


FILMS = {
    "star": Film(frames=200, share=1.0),
    "letters": Film(frames=280, share=1.0),
    "tree": Film(frames=240, share=1.0),
    "moving": Film(frames=240, share=1.0),
    "crowd": Film(frames=200, share=1.0),
    "handheld": Film(frames=200, share=1.0),
}
"""The scenarios of the gallery. Chosen: a film ends soon after its formation is complete."""


def run_scenario(name: str, folder: Path) -> None:
    """Run one scenario by the command that the home page shows, into a folder.

    Raises:
        subprocess.CalledProcessError: the run failed, or did not reach its shape.
    """
    subprocess.run([sys.executable, "-m", "skyherd", "run", name, "--out", str(folder)], check=True)


def write_film(frames: list[np.ndarray], path: Path, crf: int) -> None:
    """Write RGB frames as H.264 in an MP4 that browsers play while it loads."""
    height_px, width_px = frames[0].shape[:2]
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=RATE_HZ, options={**ENCODER, "crf": str(crf)})
        stream.width, stream.height, stream.pix_fmt = width_px, height_px, "yuv420p"
        stream.codec_context.time_base = Fraction(1, RATE_HZ)
        for pixels in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        file.mux(stream.encode())


def make_films(name: str, run: Path) -> None:
    """Write the films for wide screens and for phones, and the poster, of one run into the gallery."""
    part = FILMS[name]
    kinds = (VIDEO, name, WIDTH_PX, WIDE_CRF), (PHONE_VIDEO, f"{name}-phone", PHONE_WIDTH_PX, PHONE_CRF)
    for video, film, width_px, crf in kinds:
        count = min(part.frames, int(part.share * count_frames(run / video)))
        frames = pick_frames(run / video, count, width_px, part.share)
        write_film(frames, FOLDER / f"{film}.mp4", crf)
        if video == VIDEO:
            poster = FOLDER / f"{name}.jpg"
            Image.fromarray(frames[-1]).save(poster, quality=80, optimize=True, progressive=True)


def make_replay(name: str, recording_file: Path) -> None:
    """Write the replay of one run, which viser's client shows, into the gallery.

    Raises:
        SystemExit: the replay is too large.
    """
    recording = read_recording(recording_file)
    data = replay_data(recording.mission, recording.steps)
    if len(data) > MAX_REPLAY_MB * 1e6:
        sys.exit(f"the replay of {name} has {len(data) / 1e6:.1f} MB; allowed are {MAX_REPLAY_MB} MB")
    (FOLDER / f"{name}.viser").write_bytes(data)


def make_readme_picture(video: Path) -> None:
    """Write `docs/star.gif`, which pages without a player show."""
    frames = pick_frames(video, count=70, width_px=800, share=FILMS["star"].share)
    save_gif(hold_still(frames), DOCS / "star.gif", frame_ms=100, last_ms=2500)


def main() -> None:
    """Read the command line and make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"default: {' '.join(FILMS)}")
    parser.add_argument("--runs", type=Path, help="folder of runs that are there already")
    options = parser.parse_args()
    if unknown := set(options.names) - set(FILMS):
        parser.error(f"unknown film {min(unknown)!r}; there are: {', '.join(FILMS)}")
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        for name in options.names or FILMS:
            folder = (options.runs or Path(temporary)) / name
            if options.runs is None:
                run_scenario(name, folder)
            make_films(name, folder)
            make_replay(name, folder / RECORDING)
            if name == "star":
                make_readme_picture(folder / VIDEO)
    sizes_mb = {path.name: path.stat().st_size / 1e6 for path in sorted(FOLDER.iterdir())}
    for name, size_mb in sizes_mb.items():
        print(f"{name:20} {size_mb:6.2f} MB")
    phone = {name for name in sizes_mb if name.endswith("-phone.mp4")}
    wide = {name for name in sizes_mb if name.endswith((".mp4", ".jpg"))} - phone
    for kind, names in (("wide screens", wide), ("phones", phone)):
        total_mb = sum(sizes_mb[name] for name in names)
        print(f"{'for ' + kind:20} {total_mb:6.2f} MB")
        if total_mb > MAX_TOTAL_MB:
            sys.exit(
                f"films for {kind} have {total_mb:.1f} MB; allowed are {MAX_TOTAL_MB} MB: lower `frames`"
            )


if __name__ == "__main__":
    main()
