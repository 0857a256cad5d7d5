"""Weights are read without running code from them, and fill a network wholly or not at all."""

import os

import pytest
import torch
from safetensors.torch import save_file

from phy124.errors import InputError
from phy124.weights.checkpoints import fill, read_tensors, strip_prefix


@pytest.fixture
def tensors():
    return {"weight": torch.arange(6.0).reshape(2, 3), "bias": torch.ones(2)}


@pytest.mark.parametrize("kind", ["safetensors", "plain", "nested"])
def test_every_kind_of_file_gives_its_tensors(tmp_path, tensors, kind):
    path = tmp_path / ("a.safetensors" if kind == "safetensors" else "a.ckpt")
    if kind == "safetensors":
        save_file(tensors, path)
    else:
        torch.save({"state_dict": tensors, "epoch": 3} if kind == "nested" else tensors, path)
    read = read_tensors(path)
    assert read.keys() == tensors.keys()
    assert all(torch.equal(read[name], tensors[name]) for name in tensors)


class Attack:
    """An action that a pickle could perform."""

    def __reduce__(self):
        return os.mkdir, ("attacked",)


def test_a_file_that_would_run_code_is_refused(tmp_path, monkeypatch, tensors):
    monkeypatch.chdir(tmp_path)
    torch.save({**tensors, "more": Attack()}, tmp_path / "a.pth")
    with pytest.raises(InputError, match="cannot be read as tensors"):
        read_tensors(tmp_path / "a.pth")
    assert not (tmp_path / "attacked").exists()


@pytest.mark.parametrize("name", ["a.safetensors", "a.pt"])
def test_files_that_are_missing_or_cut_short_are_refused(tmp_path, tensors, name):
    path = tmp_path / name
    with pytest.raises(InputError, match="no such file"):
        read_tensors(path)
    save_file(tensors, path) if path.suffix == ".safetensors" else torch.save(tensors, path)
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(InputError, match="cut short or of another kind"):
        read_tensors(path)


def test_a_list_is_no_table_of_tensors(tmp_path):
    torch.save([torch.ones(2)], tmp_path / "a.pt")
    with pytest.raises(InputError, match="no table of tensors"):
        read_tensors(tmp_path / "a.pt")


def test_a_network_is_filled(tensors):
    network = torch.nn.Linear(3, 2)
    fill(network, tensors, "the layer")
    torch.testing.assert_close(network(torch.ones(1, 3)), torch.tensor([[4.0, 13.0]]))


def test_mismatched_tensors_are_named_and_change_nothing(tensors):
    network = torch.nn.Linear(3, 2)
    before = network.weight.clone()
    other = {"weight": torch.zeros(3, 3), **{f"more.{i}": torch.ones(1) for i in range(5)}}
    with pytest.raises(InputError) as refused:
        fill(network, other, "the layer")
    said = str(refused.value)
    assert "1 missing (bias)" in said and "5 unknown (more.0, more.1, more.2, ...)" in said
    assert "weight has shape [3, 3], but must have shape [2, 3]" in said
    with pytest.raises(
        InputError, match=r"1 other shape \(bias has shape \[3\], but must have shape \[2\]\)"
    ):
        fill(network, {**tensors, "bias": torch.ones(3)}, "the layer")
    assert torch.equal(network.weight, before)


def test_prefixes_go_where_there_are_any(tensors):
    named = {f"model.{name}": value for name, value in tensors.items()} | {"other": torch.ones(1)}
    assert strip_prefix(named, "model.").keys() == tensors.keys()
    assert strip_prefix(tensors, "model.").keys() == tensors.keys()
