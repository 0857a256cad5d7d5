"""What the paper's first stage costs: `python tests/benchmarks/generators.py PART [--device cpu]`.

PART is lgm (four given views to Gaussians), imagedream (one step with guidance, of 30), u2net (one
picture to its mask), or stage: a cut-out picture to Gaussians through ImageDream and LGM, for which
the paper states 23.89 s (`--steps 1` shortens it). Weights are made by formula, since trained ones
are not at hand: time and memory are the real network's, the object is not. Prints one JSON line.
Peak memory is the process's own, so run one part at a time.
"""

import argparse
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1]))
from reference import formula

REVISION = 1
"""Raise when the method changes: figures of different revisions do not compare."""


def lgm(device: str) -> dict:
    """The option `big`: 4 views of 256 x 256 to Gaussians, as `Lgm.from_views` does it."""
    from phy124.generators.lgm import OPTIONS, Lgm, LgmModel, load

    with torch.device("meta"):
        empty = LgmModel(OPTIONS["big"])
    weights = formula.state_dict(empty)
    dtype = torch.float16 if device == "cuda" else torch.float32
    start = time.perf_counter()
    model = load(weights, "big", device=device, dtype=dtype)
    loaded = time.perf_counter() - start
    del weights
    model.rotations = "each"
    generator = Lgm(model=model, device=device)
    views = formula.inputs("views", (4, 3, 256, 256), 0, 1)
    made, figures = timed(lambda: generator.from_views(views), device)
    return {"load_s": round(loaded, 2), "gaussians": len(made), **figures}


def imagedream(device: str) -> dict:
    """One of the 30 steps: ten latents of 32 x 32, five of them with the picture."""
    from phy124.generators.imagedream import Config, MultiViewUNet, load_unet

    with torch.device("meta"):
        empty = MultiViewUNet(Config())
    dtype = torch.float16 if device == "cuda" else torch.float32
    unet = load_unet(formula.state_dict(empty), device=device, dtype=dtype)
    shapes = {
        "x": (10, 4, 32, 32),
        "context": (10, 77, 1024),
        "camera": (10, 16),
        "ip": (10, 257, 1280),
        "ip_img": (2, 4, 32, 32),
    }
    given = {k: formula.inputs(k, s, -1, 1).to(device, dtype) for k, s in shapes.items()}
    t = torch.full((10,), 958, device=device)
    with torch.inference_mode():
        _, figures = timed(lambda: unet(timesteps=t, num_frames=5, **given), device)
    return figures


class FormulaParts:
    """ImageDream's networks with weights by formula."""

    def __init__(self, device: str, dtype: torch.dtype) -> None:
        from phy124.generators.imagedream import Config, MultiViewUNet, encoders, load_unet

        with torch.device("meta"):
            empty = MultiViewUNet(Config())
        self.unet = load_unet(formula.state_dict(empty), device=device, dtype=dtype)
        built = (encoders.vae(), encoders.text_encoder(), encoders.image_encoder())
        for network in built:
            network.load_state_dict(formula.state_dict(network))
        self.vae, self.text_encoder, self.image_encoder = (
            torch.nn.Module.to(n, device, dtype) for n in built
        )
        self.encoders = encoders

    def text(self) -> torch.Tensor:
        return self.encoders.empty_prompt(self.text_encoder)

    def picture(self, image: torch.Tensor) -> torch.Tensor:
        return self.encoders.picture_tokens(self.image_encoder, image)


def stage(device: str, steps: int) -> dict:
    """A cut-out picture of 512 x 512 to Gaussians; networks are in memory before it starts."""
    from phy124.generators.imagedream import ImageDream
    from phy124.generators.lgm import OPTIONS, Lgm, LgmModel, load

    dtype = torch.float16 if device == "cuda" else torch.float32
    with torch.device("meta"):
        empty = LgmModel(OPTIONS["big"])
    model = load(formula.state_dict(empty), "big", device=device, dtype=dtype)
    model.rotations = "each"
    parts = FormulaParts(device, dtype)
    views = ImageDream(parts=parts, steps=steps, device=device, dtype=dtype)
    generator = Lgm(model=model, multiview=views, device=device, dtype=dtype)
    picture = np.zeros((512, 512, 4), np.uint8)
    picture[100:400, 150:350] = 200, 150, 40, 255
    made, figures = timed(lambda: generator(picture, seed=0), device)
    return {"steps": steps, "gaussians": len(made), **figures}


def u2net(device: str) -> dict:
    """A picture of 1024 x 1024 to its mask, by the torch network."""
    from phy124.imaging import u2net as cut
    from phy124.imaging.u2net.network import WIDTHS, U2Net, load

    with torch.device("meta"):
        empty = U2Net(WIDTHS["u2net"])
    network = load(formula.state_dict(empty)).to(device)

    def run(x: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return network(torch.from_numpy(x).to(device))[0].cpu().numpy()

    picture = (np.random.default_rng(0).random((1024, 1024, 3)) * 255).astype(np.uint8)
    _, figures = timed(lambda: cut.foreground(picture, run), device)
    return figures


def timed(work, device: str):
    """Result and seconds of the second of two runs on a GPU, of the only run on a CPU."""
    if device == "cuda":
        work()
        torch.cuda.synchronize()
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    if device == "cuda":
        torch.cuda.synchronize()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return result, {"wall_s": round(wall, 2), "cpu_s": round(cpu, 2)}


PARTS = {"lgm": lgm, "imagedream": imagedream, "u2net": u2net, "stage": stage}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=30, help="of ImageDream, in `stage`")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    more = {"steps": options.steps} if options.part == "stage" else {}
    figures = PARTS[options.part](options.device, **more)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    gpu = torch.cuda.max_memory_allocated() / 2**30 if options.device == "cuda" else None
    line = {"part": options.part, "device": options.device, "threads": options.threads}
    line |= {**figures, "peak_gib": round(peak, 2), "gpu_gib": gpu, "revision": REVISION}
    print(json.dumps(line))


if __name__ == "__main__":
    main()
