"""Measures the paper's first stage: `python tests/benchmarks/generators.py PART [--device cpu]`.

PART is one of the following:

- lgm: four existing views to Gaussians;
- imagedream: one of 30 steps, with guidance, in `--precision`, and with `--compile` by torch;
- u2net: a picture to its mask;
- samplers: errors of DDIM and DPM-Solver++ for several numbers of steps (needs the golden data);
- stage: a cut-out picture to Gaussians by ImageDream and LGM, for which the paper states 23.89 s
  (`--steps 1` shortens it).

The weights are made by a formula, since trained weights are not available. Time and memory are
those of the real network, but the object is meaningless. The program prints one JSON line. It
states the peak memory of the process, so run one part at a time.
"""

import argparse
import json
import os
import resource
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1]))
from reference import formula

REVISION = 2
"""Raise when the method changes: figures of different revisions do not compare."""


def lgm(device: str) -> dict:
    """The option `big`: 4 views of 256 x 256 to Gaussians, as `Lgm.from_views` does it."""
    from phy124.generators.neural.lgm.generator import Lgm
    from phy124.generators.neural.lgm.model import OPTIONS, LgmModel, load

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


def imagedream(device: str, precision: str, compiled: bool) -> dict:
    """One of the 30 steps: ten latents of 32 x 32, five of them with the picture."""
    from phy124.generators.neural.imagedream.pipeline import Condition, predict
    from phy124.generators.neural.imagedream.unet import Config, MultiViewUNet, load_unet

    with torch.device("meta"):
        empty = MultiViewUNet(Config())
    dtype = getattr(torch, precision or ("float16" if device == "cuda" else "float32"))
    unet = load_unet(formula.state_dict(empty), device=device, dtype=dtype)
    shapes = {
        "text": (2, 77, 1024),
        "tokens": (1, 257, 1280),
        "latents": (1, 4, 32, 32),
        "cameras": (5, 16),
    }
    answer = Condition(
        **{k: formula.inputs(k, s, -1, 1).to(device, dtype) for k, s in shapes.items()}
    )
    x, level = formula.inputs("x", (5, 4, 32, 32), -1, 1).to(device), torch.tensor(958)
    run = torch.compile(unet) if compiled else unet
    with torch.inference_mode():
        step = partial(predict, run, x, level, answer)
        compiling = timed(step, device)[1]["cpu_s"] if compiled else None
        _, figures = timed(step, device)
    return {"precision": str(dtype), "first_cpu_s": compiling, **figures}


def samplers(device: str) -> dict:
    """Error of the latents by number of steps, relative to their spread, for two networks.

    `formula`: the tiny golden network with guidance 5 on latents of 8 x 8, against 200 steps of
    DDIM. `mixture`: the exact noise of eight pictures, two of them meant, against 500 of
    DPM-Solver++.
    """
    from phy124.generators.neural.imagedream.pipeline import (
        Condition,
        cameras,
        predict_guided,
        scheduler_of,
    )
    from phy124.generators.neural.imagedream.unet import load_unet

    golden = Path(os.environ.get("PHY124_GOLDEN", "../shared/golden")) / "generators"
    config = json.loads((golden / "imagedream_unet_tiny.json").read_text())["config"]
    unet = load_unet(golden / "imagedream_unet_tiny.weights.fp16.safetensors", **config)
    saved = np.load(golden / "imagedream_pipeline.npz")
    e = {key: torch.from_numpy(saved[key]) for key in saved.files}
    answer = Condition(
        torch.cat([e["neg"], e["pos"]]),
        e["image_embeds"].float(),
        e["image_latents_pos"][..., :8, :8],
        torch.from_numpy(cameras()),
    )
    left = scheduler_of("ddim", 1).alphas_cumprod.double()
    torch.manual_seed(0)
    pictures = torch.randn(8, 5, 4, 8, 8, dtype=torch.float64).cumsum(-1)
    pictures = (pictures - pictures.mean()) / pictures.std()

    def noise_of(meant, x, t):
        a = left[int(t)]
        variance, away = 0.01 * a + 1 - a, x.double() - a.sqrt() * meant
        weight = torch.softmax(-away.square().flatten(1).sum(1) / (100 * variance), 0)
        return (1 - a).sqrt() * (weight[:, None, None, None, None] * away).sum(0) / variance

    def mixture(x, t):
        without = noise_of(pictures, x, t)
        return without + 5 * (noise_of(pictures[:2], x, t) - without)

    def end(predict, x, sampler, steps):
        scheduler = scheduler_of(sampler, steps)
        with torch.inference_mode():
            for t in scheduler.timesteps:
                x = scheduler.step(predict(x, t), t, x, return_dict=False)[0]
        return x

    cases = {
        "mixture": (mixture, torch.randn(5, 4, 8, 8, dtype=torch.float64), "dpmsolver++", 500),
        "formula": (
            lambda x, t: predict_guided(unet, x, t, answer, 5.0),
            e["init_latents"][..., :8, :8],
            "ddim",
            200,
        ),
    }
    errors: dict = {}
    for name, (predict, start, best, most) in cases.items():
        limit = end(predict, start, best, most)
        for sampler in ("ddim", "dpmsolver++"):
            for steps in (5, 8, 10, 15, 20, 30, 50):
                apart = end(predict, start, sampler, steps) - limit
                error = float(apart.square().mean().sqrt() / limit.std())
                errors.setdefault(f"{name} {sampler}", {})[steps] = round(error, 4)
    return {"errors": errors}


class FormulaParts:
    """ImageDream's networks with weights by formula."""

    def __init__(self, device: str, dtype: torch.dtype) -> None:
        from phy124.generators.neural.imagedream import encoders
        from phy124.generators.neural.imagedream.unet import Config, MultiViewUNet, load_unet

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
    from phy124.generators.neural.imagedream.pipeline import ImageDream
    from phy124.generators.neural.lgm.generator import Lgm
    from phy124.generators.neural.lgm.model import OPTIONS, LgmModel, load

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


PARTS = {"lgm": lgm, "imagedream": imagedream, "u2net": u2net, "stage": stage, "samplers": samplers}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=PARTS)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=30, help="of ImageDream, in `stage`")
    parser.add_argument("--precision", help="of `imagedream`: float32, bfloat16, float16")
    parser.add_argument("--compile", action="store_true", help="`imagedream` by torch.compile")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    answer = {
        "stage": {"steps": options.steps},
        "imagedream": {"precision": options.precision, "compiled": options.compile},
    }
    more = answer.get(options.part, {})
    figures = PARTS[options.part](options.device, **more)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    gpu = torch.cuda.max_memory_allocated() / 2**30 if options.device == "cuda" else None
    line = {"part": options.part, "device": options.device, "threads": options.threads}
    line |= {**figures, "peak_gib": round(peak, 2), "gpu_gib": gpu, "revision": REVISION}
    print(json.dumps(line))


if __name__ == "__main__":
    main()
