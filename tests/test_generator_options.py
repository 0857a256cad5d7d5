"""Options of generators: who takes them, who refuses them, and what is told before the work."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

from phy124 import generators
from phy124.__main__ import main
from phy124.accuracy.forecast import Forecast
from phy124.accuracy.probe import SubstepCost
from phy124.errors import InputError
from phy124.generators.options import Effort, GeneratorOptions, Work, effort_of
from phy124.pipeline import make_gaussians
from support.shapes import ball

STEPS = GeneratorOptions(steps=7)


def test_every_entry_can_be_made():
    for name in generators.GENERATORS:
        assert callable(generators.make(name))


class Slow:
    """A generator that says it takes minutes, and counts how often it is used."""

    calls = 0

    def effort(self):
        return Effort(400.0, {"steps": 7}, "7 steps")

    def __call__(self, image_rgba, *, seed, progress):
        self.calls += 1
        return ball(300)


@pytest.fixture
def picture(tmp_path):
    pixels = np.zeros((40, 40, 4), np.uint8)
    pixels[8:32, 8:32] = 200, 90, 30, 255
    Image.fromarray(pixels).save(tmp_path / "square.png")
    return tmp_path / "square.png"


@pytest.mark.parametrize(
    ("chosen", "options", "message"),
    [
        (
            "relief",
            STEPS,
            "steps = 7: relief does not have this option. This generator has no options",
        ),
        ("a.ply", STEPS, "steps = 7: A file of Gaussians does not have this option"),
        ("cmd: x {image} {out}", STEPS, "steps = 7: A command does not have this option"),
        (Slow(), STEPS, "steps = 7: Slow does not have this option"),
        (
            "dreamgaussian",
            GeneratorOptions(sampler="ddim"),
            "does not have this option. It has steps.",
        ),
    ],
)
def test_an_option_that_a_generator_does_not_have_is_refused(chosen, options, message):
    with pytest.raises(InputError) as refusal:
        generators.make(chosen, options=options)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"options": {"steps": 7}}, "steps = 7: relief does not have this option"),
        ({"options": {"steps": "many"}}, "steps = many: it must be a whole number from 1 to 500"),
        ({"depth": {"depht": "off"}}, "depht = off: there is no such key. Did you mean depth?"),
        ({"views": {"thickness": -1}}, "thickness = -1: it must be"),
        ({"reading": {"up": "z"}}, "generator = relief: --up is for a file"),
    ],
)
def test_options_may_be_plain_data(picture, options, message):
    with pytest.raises(InputError) as refusal:
        make_gaussians(picture, **options)
    assert message in str(refusal.value)


def test_a_factory_gets_the_options_and_the_device_that_it_names(monkeypatch):
    def factory(*, device=None, steps=20):
        return (device, steps)

    monkeypatch.setitem(generators.GENERATORS, "mine", factory)
    assert generators.make("mine", options=STEPS, device="cuda:0") == ("cuda:0", 7)
    assert generators.make("mine") == (None, 20)


def test_the_command_line_refuses_what_cannot_be(picture, capsys):
    assert main(["generate", str(picture), "--steps", "5"]) == 2
    assert "relief does not have this option" in capsys.readouterr().err
    assert main(["generate", str(picture), "--generator", "lgm", "--steps", "0"]) == 2
    assert "steps" in capsys.readouterr().err


def test_long_work_is_announced_and_reported(picture):
    slow, order = Slow(), []
    made = make_gaussians(
        picture, generator=slow, on_estimate=lambda effort: order.append(slow.calls)
    )
    assert order == [0] and slow.calls == 1
    assert made.about["effort"] == {"steps": 7, "predicted": 400.0}
    assert effort_of(make_gaussians) is None


class Foreseen:
    """A forecaster that forecasts one second of simulation."""

    def __init__(self, context, error=True):
        self.context, self.error = context, error

    def forecast(self, gaussians, scene, *, crop):
        return Forecast({"simulate": 1.0}, (), 1, 1, 1, {}, SubstepCost(1e-9, 1e-9))


def test_a_dry_run_does_not_run_what_takes_long(picture, monkeypatch, capsys):
    slow = Slow()
    monkeypatch.setattr("phy124.commands.plan.Forecaster", Foreseen)
    monkeypatch.setitem(generators.GENERATORS, "slow", lambda: slow)
    options = ["--generator", "slow", "--gaussians", "500"]
    assert main(["generate", str(picture), "--dry-run", *options]) == 0
    out = capsys.readouterr().out
    assert slow.calls == 0
    assert "generator: slow, 7 steps; likely 5.3 to 10.0 min" in out
    assert "  generate      400.00 s\n" in out, "not as measured"
    assert "measured with an object made by relief" in out


@pytest.mark.parametrize("command", [["generate"], ["accuracy", "drop", "--image"]])
def test_commands_cut_out_what_was_picked(command, picture, monkeypatch, tmp_path):
    asked = []

    def cut_out(image, method, **inputs):
        asked.append((method, inputs["pick"]))
        raise InputError("image", image, "That is enough.", "Stop.")

    monkeypatch.setattr("phy124.pipeline.gaussians.cut_out", cut_out)
    options = ["--pick", "0.2,0.7", "--method", "grabcut", "--out", str(tmp_path / "out")]
    assert main([*command, str(picture), *options]) == 2
    assert asked == [("grabcut", (0.2, 0.7))]


def test_options_of_pictures_need_a_picture(capsys):
    assert main(["accuracy", "drop", "--pick", "0.2,0.3"]) == 2
    assert "--pick is for a picture" in capsys.readouterr().err


def test_seconds_are_work_over_speed():
    work = Work(100.0, 60.0, 30.0)
    assert work.at(Work(10.0, 20.0, 30.0)) == 14.0
    assert work.times(3).at(Work(10.0, 20.0, 30.0)) == 42.0


def test_lgm_tells_its_effort_and_passes_its_options_on(monkeypatch):
    from phy124.generators.neural import imagedream
    from phy124.generators.neural.lgm import generator as lgm

    monkeypatch.setattr(imagedream, "ImageDream", SimpleNamespace, raising=False)

    answer = GeneratorOptions(steps=10, sampler="dpmsolver++", precision="float32")
    monkeypatch.setattr(lgm, "speed_of", lambda device, dtype: Work(1e11, 1e11, 1e11))
    monkeypatch.setattr(lgm, "require", lambda name, weights: {name: "file"})
    long, short = (generators.make("lgm", options=o) for o in (GeneratorOptions(), answer))
    around = (371.2 + 3358.3 + 33.9 + 98.8 + 1486.6 + 194.9) / 100
    assert short.effort().seconds == pytest.approx(around + 10 * 21.819, rel=1e-3)
    assert long.effort().seconds - short.effort().seconds == pytest.approx(20 * 21.819, rel=1e-3)
    assert "10 steps of dpmsolver++ in float32 on cpu" in short.effort().words
    short._prepare_multiview()
    views = short.multiview
    assert (views.steps, views.sampler, str(views.unet_dtype)) == (
        10,
        "dpmsolver++",
        "torch.float32",
    )


def test_short_memory_uses_half_precision_and_no_cache(monkeypatch):
    from phy124.generators.neural import precision

    monkeypatch.setattr(precision, "multiplies_bfloat16", lambda: False)
    for free, chosen in ((6e9, "float32"), (4e9, "bfloat16")):
        monkeypatch.setattr(precision, "free_memory", lambda free=free: free)
        made = generators.make("lgm")
        assert str(made.diffusion_dtype) == f"torch.{chosen}"
        assert made.dtype == torch.float32
    for free, kept in ((2e9, False), (6e9, True)):
        monkeypatch.setattr(precision, "free_memory", lambda free=free: free)
        made.multiview = "networks"
        made._make_room()
        assert (made.multiview is not None) is kept


def test_the_processor_says_whether_it_multiplies_bfloat16(monkeypatch):
    from phy124.generators.neural import precision

    for features, chosen in (
        ({"avx512_bf16": True}, torch.bfloat16),
        ({"amx_bf16": True}, torch.bfloat16),
        ({"avx512_f": True}, torch.float32),
    ):
        monkeypatch.setattr(torch.cpu, "get_capabilities", lambda f=features: f, raising=False)
        assert precision.dtype_of(None, "cpu", 10) == chosen
    assert precision.dtype_of(None, "cuda:0", 10) == torch.float16
    assert precision.dtype_of("float32", "cuda:0", 10) == torch.float32
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.warns(UserWarning, match="cannot use cuda:0, so the generator runs on the CPU"):
        assert precision.torch_device("cuda:0") == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert precision.torch_device("cuda:1") == "cuda:1"
    with pytest.warns(UserWarning, match="cannot use cuda:2"):
        assert precision.torch_device("cuda:2") == "cpu"


def test_speed_is_measured_by_kind():
    from phy124.generators import options as effort

    kinds = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(effort, "_seconds", lambda work, wait: kinds.append(work) or 0.5)
        speed = effort.speed_of("cpu", torch.float32)
    assert len(kinds) == 3 and min(speed) > 1e9
    ran = []
    assert effort._seconds(lambda: ran.append(1), lambda: None) >= 0 and len(ran) == 3


@pytest.mark.slow
def test_the_work_of_the_networks_is_what_torch_counts():
    from torch.utils.flop_counter import FlopCounterMode

    from phy124.generators.neural.imagedream import AROUND, PARAMETERS, STEP, encoders
    from phy124.generators.neural.imagedream.unet import Config, MultiViewUNet
    from phy124.generators.neural.lgm.generator import WORK
    from phy124.generators.neural.lgm.model import OPTIONS, LgmModel

    def counted(network, *shapes, call=None, **more) -> Work:
        network.requires_grad_(False)
        with FlopCounterMode(display=False) as counter, torch.inference_mode():
            (call or network)(*(torch.empty(shape) for shape in shapes), **more)
        by = {str(k).split(".")[-1]: v for k, v in counter.get_flop_counts()["Global"].items()}
        linear = by.get("addmm", 0) + by.get("mm", 0)
        return Work(linear, by.get("convolution", 0), by.get("bmm", 0))

    with torch.device("meta"):
        unet, vae = MultiViewUNet(Config()), encoders.vae()
        inputs = [(5, 4, 32, 32), (5,), (5, 77, 1024)]
        step = counted(
            unet,
            *inputs,
            num_frames=5,
            camera=torch.empty(5, 16),
            ip=torch.empty(5, 257, 1280),
            ip_img=torch.empty(1, 4, 32, 32),
        )
        assert sum(p.numel() for p in unet.parameters()) == PARAMETERS
        around = [
            counted(encoders.image_encoder(), (1, 3, 224, 224)),
            counted(encoders.text_encoder(), input_ids=torch.zeros(1, 77, dtype=torch.long)),
            counted(vae, (1, 3, 256, 256), call=vae.encode),
            counted(vae, (1, 4, 32, 32), call=vae.decode).times(5),
        ]
        lgm = counted(LgmModel(OPTIONS["big"]), (1, 4, 9, 256, 256))
    around = map(sum, zip(*around, strict=True))
    for result, answer in ((step.times(2), STEP), (around, AROUND), (lgm, WORK)):
        assert tuple(result) == pytest.approx(tuple(answer), rel=1e-3)


def test_generating_without_weights_is_refused_in_a_sentence(
    picture, tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "hub"))
    monkeypatch.delenv("PHY124_WEIGHTS", raising=False)
    out = str(tmp_path / "out")
    for name in ("lgm", "dreamgaussian"):
        assert main(["generate", str(picture), "--generator", name, "--out", out]) == 2
        error = capsys.readouterr().err
        assert "phy124 weights fetch" in error and "`relief`" in error
        assert "Traceback" not in error
    assert not (tmp_path / "out").exists()
