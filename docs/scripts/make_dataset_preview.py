"""Make the picture of a labelled image set that the README shows, `docs/dataset.jpg`."""

from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from skyherd.datasets import draw_preview, load_spec, make_dataset

WIDTH_PX = 1200


def main() -> None:
    """Make the built-in set `small`, and save two rows of its preview."""
    with TemporaryDirectory() as folder:
        sheet = Image.fromarray(draw_preview(make_dataset(load_spec("small"), Path(folder)), rows=2))
    picture = sheet.resize((WIDTH_PX, round(WIDTH_PX * sheet.height / sheet.width)), Image.Resampling.LANCZOS)
    path = Path(__file__).parent.parent / "dataset.jpg"
    picture.save(path, quality=85, optimize=True)
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
