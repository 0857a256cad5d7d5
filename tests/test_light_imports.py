"""phy124.runtime.light_imports: without the parts that only documentation and tests need."""

import json
import sys
from pathlib import Path

import pytest

from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.processes import run_program
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

HEAVY = {"torch", "diffusers", "gradio", "mcap", "transformers", "rclpy"}
HUB = HEAVY | {"huggingface_hub"}
SCIPY = {f"scipy.{part}" for part in ("fft", "linalg", "ndimage", "sparse", "spatial", "special")}
LIBRARIES = HEAVY | {"warp", "numpy", "scipy", "cv2", "PIL", "pydantic"}
BRIDGE = "bridge.live, bridge.node, bridge.backends, bridge.recover, bridge.sinks.mcap, "
BRIDGE += "bridge.sinks.dds, bridge.sinks.rclpy, bridge.sinks.foxglove"
WEIGHTS = "from phy124.weights import checkpoints, store"
MAIN = "from phy124.__main__ import main; "
UNUSED = ["numpy.f2py", "numpy.polynomial", "numpy.testing", "unittest.mock", "asyncio", "ssl"]


def imported_after(code: str) -> list[str]:
    """Return the modules of `UNUSED` that a program has imported."""
    last = f"import sys; print(*(name for name in {UNUSED} if name in sys.modules))"
    program = f"{code}\n{last}"
    words = [sys.executable, "-c", program]
    done = run_program(words)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


STAGES = (
    ("import phy124; phy124.__all__, dir(phy124)", LIBRARIES | {"tqdm", "imageio"}),
    ("import phy124, phy124.__main__, phy124.commands", LIBRARIES | {"tyro", "safetensors"}),
    (MAIN + "main(['--help'])", LIBRARIES),
    (MAIN + "main(['weights'])", HEAVY | {"warp", "scipy", "cv2"}),
    ("import phy124.scene, phy124.generators", HEAVY | SCIPY | {"cv2", "scipy"}),
    ("from phy124.commands import fit, generate, sweep", HEAVY | SCIPY),
    ("from phy124 import metrics; from phy124.imaging import u2net; " + WEIGHTS, HUB),
)
"""Code, and what neither it nor the code before it imports: one process runs them all."""


@pytest.fixture(scope="module")
def imported() -> dict[str, set[str]]:
    """The names of the imported modules after each stage."""
    codes = [code for code, _ in STAGES]
    program = (
        "import contextlib, sys\n"
        f"for code in {codes!r}:\n"
        "    with contextlib.suppress(SystemExit):\n"
        "        exec(code)\n"
        "    print(*sys.modules, file=sys.stderr)\n"
    )
    run = run_program([sys.executable, "-c", program], check=True)
    return dict(zip(codes, map(set, map(str.split, run.stderr.splitlines())), strict=True))


@pytest.mark.parametrize(("code", "absent"), STAGES)
def test_importing_is_light(imported, code, absent):
    """Neither a package nor a command pulls in what only others need."""
    assert absent & imported[code] == set()


def test_importing_the_bridge_is_light():
    run = run_program([sys.executable, "-c", f"import phy124, {BRIDGE}, sys; print(*sys.modules)"])
    absent = HEAVY | {"cyclonedds", "foxglove", "warp", "tyro"}
    assert run.returncode == 0 and absent & set(run.stdout.split()) == set(), run.stderr


def test_scipy_is_imported_without_test_helpers() -> None:
    """SciPy works, and NumPy's unused modules can still be imported later."""
    code = (
        "import numpy as np\n"
        "from phy124.runtime.light_imports import SCIPY, import_lightly\n"
        "import_lightly(*SCIPY)\n"
        "import scipy\n"
        "assert 'Gaussian' in scipy.ndimage.gaussian_filter.__doc__\n"
        "assert scipy.ndimage.label(np.eye(3))[1] == 3\n"
    )
    assert imported_after(code) == []
    later = (
        "np.testing.assert_allclose(1, 1)\nimport numpy.f2py\nassert numpy.f2py.run_main\n"
        "assert np.polynomial.Polynomial([1, 2])(3) == 7\n"
    )
    assert "numpy.f2py" in imported_after(code + later)


@pytest.mark.slow
def test_render_imports_no_test_helpers(tmp_path: Path) -> None:
    """A film computes its shadows without the parts of NumPy that only tests need."""
    scene = Scene.named("press").replaced({"accuracy.cells": 8, "time.frames": 1})
    clip = Simulation(prepare(ball(100), scene, RunContext(threads=1))).run()
    clip.save(tmp_path / "clip.safetensors")
    size = "'--size', '32', '--views', 'front', '--stage', 'studio'"
    code = (
        "from phy124.__main__ import main\n"
        f"words = ['render', {str(tmp_path / 'clip.safetensors')!r}, {size}, '--quiet']\n"
        "assert main(words) == 0\n"
    )
    assert imported_after(code) == []


def test_parser_is_imported_without_event_loop() -> None:
    """Typeguard checks values as usual, and unittest.mock can still be imported later."""
    code = (
        "from phy124.runtime.light_imports import import_lightly\n"
        "import_lightly('typeguard')\n"
        "import typeguard\n"
        "typeguard.check_type((1, 2), tuple[int, ...])\n"
        "try:\n    typeguard.check_type(('a',), tuple[int, ...])\n"
        "except typeguard.TypeCheckError:\n    pass\n"
        "else:\n    raise SystemExit('not checked')\n"
    )
    assert imported_after(code) == []
    assert "unittest.mock" in imported_after(
        code + "from unittest.mock import Mock, patch\nMock()\n"
    )


def test_schemas_are_imported_without_their_dictionaries() -> None:
    """Pydantic validates as usual, and typed dictionaries of others are complete."""
    code = (
        "from phy124.runtime.light_imports import import_lightly\n"
        "import_lightly('pydantic_core.core_schema')\n"
        "from typing_extensions import TypedDict\n"
        "from pydantic import BaseModel, ValidationError\n"
        "from pydantic_core.core_schema import IntSchema\n"
        "assert not getattr(IntSchema, '__required_keys__', None)\n"
        "Size = TypedDict('Size', {'width': int})\n"
        "Picture = type('Picture', (BaseModel,), {'__annotations__': {'size': Size}})\n"
        "assert Picture(size={'width': '3'}).size == {'width': 3}\n"
        "try:\n    Picture(size={})\n"
        "except ValidationError:\n    pass\n"
        "else:\n    raise SystemExit('not checked')\n"
    )
    assert imported_after(code) == []


def test_scenes_are_listed_without_warp_and_numpy() -> None:
    code = "import sys\nfrom phy124.__main__ import main\nassert main(['scenes', '--json']) == 0"
    last = "print(*({'warp', 'numpy', 'pydantic'} & sys.modules.keys()))"
    done = run_program([sys.executable, "-c", f"{code}\n{last}"], check=True)
    listed, loaded = done.stdout.splitlines()
    assert json.loads(listed)["press"].startswith("A plate comes down") and not loaded
