"""C++ of the kernels: text in the hash of a module, called with a plain kernel's arguments."""

import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from phy124.kernels import native
from phy124.kernels.build import kernel

ROOT = Path(__file__).parents[1]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """Other files in place of those of the package."""
    monkeypatch.setattr(native, "FOLDER", tmp_path)
    return tmp_path


def scale(values: wp.array(dtype=float), factor: float, out: wp.array(dtype=float)):
    """The plain form."""
    out[wp.tid()] = factor * values[wp.tid()]


def scaled(out: str) -> wp.Kernel:
    """The plain form's parameters with C++ that writes `out`."""
    body = f"out.data[thread] = {out};"
    return native.native_kernel("phy124_test_native", body, name="scaled")(scale)


def test_pieces_are_joined_in_order(folder):
    (folder / "a.h").write_text("// head\nint x;\n\n//: one\n++x;\n\n//: two\n--x;\n")
    assert native.code("a:two", "a").split() == ["--x;", "//", "head", "int", "x;"]
    with pytest.raises(KeyError):
        native.code("a:three")


def test_constants_keep_every_digit():
    text = native.constants("double", third=1 / 3, v=wp.vec3(1.0, 2.0, 0.5))
    assert text == "const double third = 0.3333333333333333, v[] = {1.0, 2.0, 0.5};\n"


def test_native_kernel_takes_the_plain_kernels_arguments():
    plain, values = kernel("phy124_test_plain")(scale), np.arange(5, dtype=np.float32)
    results = []
    for form in (plain, scaled("factor * values.data[thread]")):
        out = wp.zeros(5, dtype=float, device="cpu")
        inputs = [wp.array(values, dtype=float, device="cpu"), 3.0]
        wp.launch(form, 5, inputs=inputs, outputs=[out], device="cpu")
        results.append(out.numpy())
    np.testing.assert_array_equal(*results)
    assert results[0][4] == 12


def test_native_function_returns_its_result():
    three = native.native_func("return 3 * thread;", scale, "three", returns=int)

    @kernel("phy124_test_result")
    def count(values: wp.array(dtype=float), out: wp.array(dtype=float)):
        out[wp.tid()] = float(three(wp.tid(), values, 1.0, out))

    out = wp.zeros(3, dtype=float, device="cpu")
    wp.launch(count, 3, inputs=[out], outputs=[out], device="cpu")
    assert out.numpy().tolist() == [0, 3, 6]


def test_module_hash_follows_the_text(folder):
    """Otherwise a cached module would go on running the text that it was compiled from."""
    hashes = []
    for text in ("factor", "factor + 1.0f", "factor"):
        (folder / "a.h").write_text(text)
        hashes.append(scaled(native.code("a")).module.get_module_hash(1))
    assert hashes[0] == hashes[2] != hashes[1]


@pytest.mark.parametrize("path", sorted(native.FOLDER.glob("*.h")), ids=lambda path: path.stem)
def test_header_names_its_plain_form_and_its_test(path):
    head = path.read_text("utf-8")
    assert re.search(r"^// Python version: .*\.$", head, re.M)
    file, name = re.search(r"^// Test: (\S+\.py), (\w+)\.$", head, re.M).groups()
    assert f"def {name}(" in (ROOT / file).read_text("utf-8")
