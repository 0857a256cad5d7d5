"""The notebook and the Dockerfile of docs/guide/platforms.md."""

import json
import re
from pathlib import Path

import pytest

from phy124.runtime.installation import packages

ROOT = Path(__file__).parents[1]


@pytest.mark.usefixtures("coarse_solids")
def test_notebook_is_valid_and_its_cells_run(tmp_path, monkeypatch, capsys):
    notebook = json.loads((ROOT / "docs/phy124.ipynb").read_text("utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    cells = notebook["cells"]
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert all({"cell_type", "metadata", "source"} <= cell.keys() for cell in cells)
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in code)
    (tmp_path / "demo").symlink_to(ROOT / "demo")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for cell in code:
        exec("".join(cell["source"]), names)
    assert len(names["clip"]) == 24 and Path("out/notebook/front.mp4").is_file()
    assert "lowest point in each frame" in capsys.readouterr().out


def test_image_has_what_its_build_needs_and_another_user():
    """The Dockerfile's context, its extras, and that it does not run as root."""
    lines = (ROOT / "Dockerfile").read_text("utf-8")
    kept = re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text("utf-8"), re.M)
    assert all((ROOT / name).exists() for name in kept)
    assert {"pyproject.toml", "setup.py", "README.md", "phy124", "demo", "bridge"} <= set(kept)
    extras = re.search(r"/opt/source\[([\w,]+)\]", lines)[1].split(",")
    assert all(packages(extra) for extra in extras)
    assert lines.index("pip install") < lines.index("USER phy124") < lines.index("HEALTHCHECK")
