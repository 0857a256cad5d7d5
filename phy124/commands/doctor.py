"""`phy124 doctor` checks this installation."""

import json
import platform
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from phy124.commands.weights import data, lines, summary
from phy124.errors import InputError
from phy124.io.video import encoder_problem, refuse_missing_encoder
from phy124.runtime.cores import cores
from phy124.runtime.device import driver
from phy124.runtime.installation import install_command, with_program
from phy124.runtime.memory import free_memory
from phy124.runtime.startup import start
from phy124.weights.store import check_all

EXTRAS = {
    "lgm": ("torch", "diffusers", "transformers"),
    "onnx": ("onnxruntime", "huggingface_hub"),
    "gpu": ("gsplat",),
    "eval": ("torch", "transformers"),
    "heic": ("pi_heif",),
    "demo": ("gradio", "websockets", "pi_heif", "cma"),
    "bridge": ("mcap",),
    "dds": ("cyclonedds",),
    "draco": ("DracoPy",),
    "foxglove": ("foxglove",),
    "exr": ("OpenEXR",),
    "usd": ("pxr",),
    "plots": ("matplotlib",),
    "mesh": ("trimesh",),
    "sweep": ("ray", "pyarrow", "fsspec"),
    "s3": ("ray", "pyarrow", "fsspec", "s3fs"),
    "fit": ("cma",),
    "fourdgs": ("fourdgs",),
}


@dataclass(frozen=True)
class Doctor:
    """Check this installation: Python, devices, video encoder, optional extras, weights."""

    weights: Path | None = None
    """Folder that is searched first for trained weights."""
    all: bool = False
    """Also list every file of weights with its checksum, the folders searched, and the download
    command.
    """
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Print the results of all checks; return status 1 if a required part is missing."""
        facts, files = examine(), check_all(self.weights, check=self.all or self.json)
        if self.json:
            print(json.dumps({**facts, "weights": data(files)}))
        else:
            for name, value in facts.items():
                if name != "faults":
                    print(f"{name:<12}{_text(value)}")
            if self.all:
                print("\n".join(["weights", *lines(files)]))
            else:
                print(f"{'weights':<12}{summary(files)}")
                print(with_program("To list every file of weights: `phy124 doctor --all`"))
            for sentence in facts["faults"]:
                print(f"{'FAULT':<12}{sentence}")
        return 1 if facts["faults"] else 0


def examine() -> dict[str, Any]:
    """Return data about this machine and installation."""
    import warp as wp

    start()
    return {
        "python": platform.python_version(),
        "warp": wp.__version__,
        "cores": cores(),
        "memory": f"{free_memory() / 1e9:.1f} GB free",
        "devices": [f"{device} ({device.name})" for device in wp.get_devices()],
        "driver": str(driver()),
        "encoder": _encoder(),
        "cache": wp.config.kernel_cache_dir,
        "extras": {
            extra: [m for m in modules if find_spec(m) is None] or "installed"
            for extra, modules in EXTRAS.items()
        },
        "faults": _faults(),
    }


def _encoder() -> str | None:
    import imageio_ffmpeg

    return None if encoder_problem() else imageio_ffmpeg.get_ffmpeg_exe()


def _faults() -> list[str]:
    try:
        refuse_missing_encoder()
    except InputError as fault:
        return [f"{fault.limit[:1].upper()}{fault.limit[1:]} {fault.remedy}"]
    return []


def _text(value: Any) -> str:
    if isinstance(value, dict):
        missing = {k: v for k, v in value.items() if v != "installed"}
        fine = ", ".join(k for k in value if k not in missing) or "none"
        rest = "; ".join(f"{k} needs `{install_command(k)}`" for k in missing)
        return f"{fine}{'; ' + rest if rest else ''}"
    if value is None:
        return "none"
    return ", ".join(value) if isinstance(value, list) else str(value)
