"""Make a small looping GIF of a run's video.

python docs/scripts/make_gif.py runs/star/video.mp4 docs/star.gif
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

from skyherd.drawing.palette import TEMPLATE_COLOR, UNIT_COLORS, rgb
from skyherd.files.video_writer import count_frames, read_frames

STILL = 14
"""Change below which a pixel keeps its old colour. Noise costs bytes."""

PALE = 225
"""Threshold in every channel above which a pixel is background."""


def pick_frames(video: Path, count: int, width_px: int, share: float) -> list[np.ndarray]:
    """Return about `count` evenly spaced frames of the first `share` of a video, scaled to `width_px`."""
    wanted = set(np.linspace(0, share * (count_frames(video) - 1), count).round().astype(int).tolist())
    frames = []
    for k, frame in enumerate(read_frames(video)):
        if k in wanted:
            height_px = round(frame.shape[0] * width_px / frame.shape[1])
            small = Image.fromarray(frame).resize((width_px, height_px), Image.Resampling.LANCZOS)
            frames.append(np.asarray(small))
        if k >= max(wanted):
            break
    return frames


def hold_still(frames: list[np.ndarray]) -> list[np.ndarray]:
    """Return frames in which pixels change only visibly; pale ones always change."""
    held = [frames[0]]
    for frame in frames[1:]:
        change = np.abs(frame.astype(np.int16) - held[-1]).max(axis=2, keepdims=True)
        limit = np.where(frame.min(axis=2, keepdims=True) > PALE, 1, STILL)
        held.append(np.where(change < limit, held[-1], frame))
    return held


def make_palette() -> Image.Image:
    """Return a palette: greys, and the shades of every coded colour."""
    strong = np.array([rgb(color) for color in (*UNIT_COLORS[:7], TEMPLATE_COLOR)])
    mixed = [strong + (255 - strong) * share for share in (0.0, 0.25, 0.5, 0.75)]
    greys = np.linspace(20, 255, 32)[:, None] * np.ones(3)
    colors = np.concatenate([*mixed, greys]).round().astype(np.uint8)
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors.tobytes())
    return palette


def save_gif(frames: list[np.ndarray], path: Path, frame_ms: int, last_ms: int) -> None:
    """Write frames as a looping GIF that pauses on its last frame."""
    palette = make_palette()
    pictures = [Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    durations = [frame_ms] * (len(pictures) - 1) + [last_ms]
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=True, disposal=1
    )


def main() -> None:
    """Read the command line and make the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", type=Path)
    parser.add_argument("gif", type=Path)
    parser.add_argument("--frames", type=int, default=70)
    parser.add_argument("--width", type=int, default=800, help="px")
    parser.add_argument("--share", type=float, default=1.0, help="of the video, from its start")
    parser.add_argument("--frame-ms", type=int, default=100)
    options = parser.parse_args()
    frames = pick_frames(options.video, options.frames, options.width, options.share)
    save_gif(hold_still(frames), options.gif, options.frame_ms, last_ms=2500)
    print(f"{options.gif}: {len(frames)} frames, {options.gif.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
