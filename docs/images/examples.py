"""Make the pictures of the examples: docs/examples/NAME.webp for each docs/examples/NAME.py.

Each program runs in an empty folder. Its picture has a row for each video that the program makes,
with several instants of this video. If the program makes no video, its picture is its chart. Run
`python docs/images/examples.py [NUMBER ...]`.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "docs/examples"
COLUMNS, HEIGHT, LOWEST = 6, 160, 96
"""Number of instants per video; height of a row [pixels] for up to three and for more videos."""
CHART = 640
"""Largest width of a chart [pixels]."""


def picture(program: Path) -> Image.Image:
    """Run a program and return the picture of its results."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "demo").symlink_to(ROOT / "demo")
        subprocess.run([sys.executable, program], cwd=folder, check=True)
        films = find_films(Path(folder, "out"))
        if films:
            height = HEIGHT if len(films) <= 3 else LOWEST
            return stacked([row(film, height) for film in films])
        (chart,) = Path(folder, "out").rglob("*.png")
        with Image.open(chart) as opened:
            opened.thumbnail((CHART, CHART))
            return opened.convert("RGB")


def find_films(folder: Path) -> list[Path]:
    """Return the videos in a folder, or only the video of an object in its photograph."""
    files = [path for ending in ("mp4", "webp") for path in sorted(folder.rglob(f"*.{ending}"))]
    films = [file for file in files if len(imageio.imread(file, index=...)) > 1]
    return [film for film in films if film.stem == "composed"] or films


def row(film: Path, height: int) -> Image.Image:
    """Return several instants of a video, evenly spaced from first to last, side by side."""
    frames = imageio.imread(film, index=...)
    chosen = frames[np.linspace(0, len(frames) - 1, COLUMNS).round().astype(int)]
    images = []
    for frame in chosen:
        image = Image.fromarray(frame).convert("RGBA")
        size = round(height * image.width / image.height), height
        white = Image.new("RGBA", image.size, "white")
        images.append(Image.alpha_composite(white, image).convert("RGB").resize(size))
    return Image.fromarray(np.concatenate([np.asarray(image) for image in images], axis=1))


def stacked(rows: list[Image.Image]) -> Image.Image:
    """Return a picture with the rows below each other, on white."""
    whole = Image.new("RGB", (max(r.width for r in rows), sum(r.height for r in rows)), "white")
    top = 0
    for image in rows:
        whole.paste(image, (0, top))
        top += image.height
    return whole


def main() -> None:
    """Make the pictures of the programs whose numbers are arguments, or of all programs."""
    numbers = sys.argv[1:] or [path.name[:2] for path in sorted(EXAMPLES.glob("[0-9]*.py"))]
    for number in numbers:
        (program,) = EXAMPLES.glob(f"{number}_*.py")
        target = program.with_suffix(".webp")
        picture(program).save(target, quality=70, method=6)
        sys.stdout.write(f"{target.name}: {target.stat().st_size / 1024:.0f} kB\n")


if __name__ == "__main__":
    main()
