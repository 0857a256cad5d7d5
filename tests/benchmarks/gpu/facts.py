"""Describes the machine: card, driver, toolkit, memory, and how Warp, torch and gsplat see it."""

import json
import shutil
import subprocess
from importlib.util import find_spec
from typing import Any

import warp as wp
from arguments import device_asked

from phy124.commands.doctor import examine

QUERY = "name,driver_version,compute_cap,memory.total,clocks.max.sm,clocks.max.memory,power.limit"


def smi() -> str | None:
    """Return the output of the driver's program, or None."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return None
    command = [program, f"--query-gpu={QUERY}", "--format=csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return (done.stdout or done.stderr).strip()


def warp_facts(name: str) -> dict[str, Any]:
    """A device as Warp sees it."""
    device: Any = wp.get_device(name)
    results = {
        "warp": wp.__version__,
        "name": device.name,
        "toolkit": wp.get_cuda_toolkit_version(),
        "driver": wp.get_cuda_driver_version(),
        "devices": wp.get_cuda_device_count(),
    }
    if device.is_cuda:
        results |= {
            "architecture": device.arch,
            "multiprocessors": device.sm_count,
            "memory_gib": device.total_memory / 2**30,
            "free_gib": device.free_memory / 2**30,
            "memory_pool": device.is_mempool_enabled,
            "conditional_graphs": wp.is_conditional_graph_supported(),
        }
    return results


def torch_facts() -> dict[str, Any]:
    """Whether torch can use the card, and whether gsplat is there."""
    results: dict[str, Any] = {"gsplat": find_spec("gsplat") is not None}
    if find_spec("torch"):
        import torch

        results |= {"torch": torch.__version__, "cuda": torch.version.cuda}
        results["usable"] = torch.cuda.is_available()
    return results


if __name__ == "__main__":
    asked = device_asked(__doc__).device
    doctor = examine()
    for what, facts in (
        ("doctor", doctor),
        ("nvidia-smi", smi()),
        ("warp", warp_facts(asked)),
        ("torch", torch_facts()),
    ):
        print(json.dumps({"what": what, "facts": facts}, default=str), flush=True)
