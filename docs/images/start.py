"""Make the pictures of docs/start: run the commands on its page, and put their videos in rows.

`blender.webp` needs the package `bpy` for the same Python; without it, the file is not changed. The
picture of the web page is made by screenshots.py. Run `python docs/images/start.py`.
"""

import importlib.util
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from examples import ROOT, row, stacked
from PIL import Image

START = ROOT / "docs/start"
HEIGHT = 160
FILMS = {
    "duck-press": ["duck-press/front.mp4"],
    "teddy-drop": ["teddy-drop/front.mp4"],
    "softer": ["softer/front.mp4", "stiffer/front.mp4"],
    "substances": ["teddy-snow/front.mp4", "duck-water/front.mp4", "sand/front.mp4"],
    "pushed": ["potted_plant-sway/front.mp4", "pushed/front.mp4"],
    "views": ["behind/azimuth-150.mp4", "portrait/front.mp4", "transparent/front.webp"],
    "collide": ["duck-collide/front.mp4"],
}
"""For each picture on the page, the videos in out/ that are its rows."""


def main() -> None:
    """Run all commands, then make all pictures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for part in (".venv", "demo", "docs"):
            (folder / part).symlink_to(ROOT / part)
        duck = "demo/examples/duck.png --scene press --out out/duck-press"
        run(f".venv/bin/phy124 generate {duck}", folder)
        page = (START / "index.md").read_text("utf-8")
        for block in re.findall(r"^```sh\n(.*?)^```", page, re.M | re.S):
            for command in block.splitlines():
                if not command.startswith("make"):
                    run(command.replace("python -m bridge", "phy124-bridge"), folder)
        for picture, films in FILMS.items():
            rows = [row(folder / "out" / film, HEIGHT) for film in films]
            save(stacked(rows), picture)
        save(points(folder / "out/duck-press/clip-bag"), "foxglove")
        if importlib.util.find_spec("bpy"):
            save(blender(folder / "out/duck-frames"), "blender")


def run(command: str, folder: Path) -> None:
    if " generate " in command:
        command += " --views front"  # The other films are not shown.
    print(command, flush=True)
    subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)


def save(image: Image.Image, name: str) -> None:
    image.save(START / f"{name}.webp", quality=75, method=6)
    print(name, (START / f"{name}.webp").stat().st_size // 1024, "kB", flush=True)


def points(bag: Path, count: int = 6) -> Image.Image:
    """Draw the point clouds in a bag at six instants, seen from the front."""
    from matplotlib import pyplot as plt
    from rosbags.highlevel import AnyReader

    with AnyReader([bag]) as reader:
        clouds = [c for c in reader.connections if c.topic == "/phy124/points"]
        read = [reader.deserialize(d, c.msgtype) for c, _, d in reader.messages(clouds)]
    figure, axes = plt.subplots(1, count, figsize=(9.6, 1.6), sharex=True, sharey=True, dpi=100)
    figure.subplots_adjust(0, 0, 1, 1, 0, 0)
    chosen = np.linspace(0, len(read) - 1, count).round().astype(int)
    for panel, index in zip(axes, chosen, strict=True):
        columns = read[index].data.reshape(read[index].width, -1)
        x, y, z = columns[:, :12].copy().view(np.float32).T
        order = np.argsort(x)
        rgb = columns[:, 14:11:-1] / 255  # packed as 0x00RRGGBB, little-endian
        panel.scatter(y[order], z[order], 0.3, rgb[order], linewidths=0)
        panel.set(aspect="equal", facecolor="#20242b", xticks=[], yticks=[])
    figure.canvas.draw()
    return Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")


def blender(frames: Path) -> Image.Image:
    """Render six frames in Blender's startup scene, as docs/start/blender.py sets it up."""
    import runpy

    import bpy

    bpy.ops.wm.read_factory_settings()
    sys.argv[1:] = [str(frames)]
    runpy.run_path(str(START / "blender.py"), run_name="__main__")
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", 32
    scene.render.resolution_x = scene.render.resolution_y = HEIGHT
    images = []
    for frame in np.linspace(1, scene.frame_end, 6).round().astype(int):
        scene.frame_set(int(frame))
        scene.render.filepath = str(frames / "rendered.png")
        bpy.ops.render.render(write_still=True)
        with Image.open(frames / "rendered.png") as opened:
            images.append(np.asarray(opened.convert("RGB")))
    return Image.fromarray(np.concatenate(images, axis=1))


if __name__ == "__main__":
    main()
