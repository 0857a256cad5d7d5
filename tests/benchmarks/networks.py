"""Measures TripoSR: `python tests/benchmarks/networks.py prepare|int8|weights8|torch FOLDER`.

`prepare` writes networks of the true size with seeded weights to the folder: the checkpoint, and
ONNX files with 8-bit weights and activations (int8) and with 8-bit weights alone (weights8, which
needs the package onnx_ir). The other parts each measure one network. Time and memory are those of
the trained network, but the object is meaningless. The network's density is computed, and then
replaced by the density of an ellipsoid. The program prints one JSON line. It states the peak memory
of the process, so run one part at a time. `cpu_s` is the sum over the cores.
"""

import argparse
import json
import resource
import sys
import time
from pathlib import Path

import numpy as np

FILES = {"int8": "triposr_encoder_int8.onnx", "weights8": "triplane_q8.onnx"}


def prepare(folder: Path) -> None:
    """Write the checkpoint and the ONNX files."""
    import torch
    from onnxruntime.quantization import QuantType, quantize_dynamic

    from phy124.generators.neural.triposr.network import Sizes, TripoSr

    torch.manual_seed(124)
    torch.set_grad_enabled(False)
    network = TripoSr(Sizes()).eval()
    embeddings = network.image_tokenizer["model"].embeddings
    torch.nn.init.normal_(embeddings.position_embeddings, std=0.02)
    torch.save(network.state_dict(), folder / "model.ckpt")
    positions = embeddings._positions(32, 32)
    embeddings._positions = lambda rows, columns: positions  # no bicubic interpolation in the file
    export = {"opset_version": 17, "dynamo": False}
    whole = str(folder / "triplane.onnx")
    names = {"input_names": ["image"], "output_names": ["triplane"]}
    torch.onnx.export(network, (torch.rand(1, 3, 512, 512),), whole, **names, **export)
    outputs = ["density", "color"]
    free = {name: {0: "points"} for name in ("features", *outputs)}
    names = {"input_names": ["features"], "output_names": outputs, "dynamic_axes": free}
    decoder = str(folder / "decoder.onnx")
    torch.onnx.export(network.decoder, (torch.rand(64, 120),), decoder, **names, **export)
    quantize_dynamic(whole, folder / FILES["int8"], weight_type=QuantType.QInt8)
    write_weights8(whole, folder / FILES["weights8"])


def write_weights8(whole: str, path: Path) -> None:
    """Quantise the weights of matrix products to 8 bits in blocks of 32."""
    import onnx
    from onnxruntime.quantization import matmul_nbits_quantizer as nbits

    settings = nbits.DefaultWeightOnlyQuantConfig(
        block_size=32, is_symmetric=False, accuracy_level=4, bits=8
    )
    quantizer = nbits.MatMulNBitsQuantizer(onnx.load(whole), algo_config=settings)
    quantizer.process()
    quantizer.model.save_model_to_file(str(path), use_external_data_format=True)


def measure(part: str, folder: Path) -> dict:
    """Load one form of the network, run it once, and cover a surface."""
    from phy124.generators.neural.triposr import generator
    from phy124.generators.neural.triposr.field import Field
    from phy124.generators.neural.triposr.surface import cover_field

    figures: dict = {}

    def timed(name, work):
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        figures[f"{name}_s"] = round(time.perf_counter() - wall, 1)
        figures[f"{name}_cpu_s"] = round(time.process_time() - cpu, 1)
        return result

    if part == "torch":
        make = timed("load", lambda: generator.load_torch(folder / "model.ckpt"))
    else:
        files = folder / FILES[part], folder / "decoder.onnx"
        make = timed("load", lambda: generator.load_onnx(*files))
    image = np.random.default_rng(0).random((1, 3, 512, 512), np.float32)
    field = timed("network", lambda: make(image))

    def decode(points, features):
        _, colour = field.decode(points, features)
        r = np.linalg.norm(points * [1, 1.3, 0.9], axis=1, keepdims=True)
        return 25 * np.exp(30 * (0.55 - r)), colour

    made = timed("surface", lambda: cover_field(Field(field.triplane, decode)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return {"gaussians": len(made), "peak_gb": round(peak, 2), **figures}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["prepare", "torch", *FILES])
    parser.add_argument("folder", type=Path)
    arguments = parser.parse_args()
    if arguments.part == "prepare":
        prepare(arguments.folder)
        return
    print(json.dumps({"part": arguments.part, **measure(arguments.part, arguments.folder)}))


if __name__ == "__main__":
    sys.exit(main())
