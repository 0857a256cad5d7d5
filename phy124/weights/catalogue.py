"""Lists the public files of trained weights, with their licences and checksums.

Weights whose terms forbid commercial use are not listed.
"""

from dataclasses import dataclass

ANYWHERE = "anywhere, also commercially"
OPENRAIL = "anywhere, also commercially, except for the harmful uses that its licence lists"


@dataclass(frozen=True)
class WeightFile:
    """A public weight file in a repository on huggingface.co."""

    repo: str
    path: str
    licence: str
    size: int | None = None
    """Size of the file [bytes]; None if unknown."""
    sha256: str | None = None
    """Published checksum; if None, `fetch` uses the checksum from the server."""
    shipped: bool = False

    @property
    def command(self) -> str:
        """The shell command that downloads the file to the Hugging Face cache."""
        return f"hf download {self.repo} {self.path}"

    @property
    def expected(self) -> str:
        """Expected size and checksum, as text."""
        size = "size unknown" if self.size is None else f"{self.size:,} bytes"
        return f"{size}, sha256 {self.sha256 or 'not known'}"


_U2NET = "Apache-2.0 (U-2-Net; no separate statement for the weights)"
_IPMV = "CreativeML OpenRAIL"
_ZERO123 = "MIT, as zero123-xl-diffusers is tagged"
_MIRROR = "tomjackson2023/rembg"
_IMAGEDREAM = "ashawkey/imagedream-ipmv-diffusers"
_TRIPOSR_Q8 = "cgb/triposr-onnx-webgpu"
_ZERO123_REPO = "bennyguo/zero123-xl-diffusers"
KNOWN: dict[str, tuple[WeightFile, ...]] = {
    # The files of this mirror are identical to github.com/danielgatis/rembg/releases/tag/v0.0.0.
    "u2net": (
        WeightFile(
            _MIRROR,
            "u2net.onnx",
            _U2NET,
            175_997_641,
            "8d10d2f3bb75ae3b6d527c77944fc5e7dcd94b29809d47a739a7a728a912b491",
        ),
    ),
    "u2netp": (
        WeightFile(
            _MIRROR,
            "u2netp.onnx",
            _U2NET,
            4_574_861,
            "309c8469258dda742793dce0ebea8e6dd393174f89934733ecc8b14c76f4ddd8",
            shipped=True,
        ),
    ),
    "lgm": (
        WeightFile(
            "ashawkey/LGM",
            "model_fp16_fixrot.safetensors",
            "MIT",
            830_126_160,
            "744d6324656342c64f871308e73db97f0eb51858d94329b30090e986a6d050ab",
        ),
    ),
    "lgm-fp32": (
        WeightFile(
            "ashawkey/LGM",
            "model_fixrot.safetensors",
            "MIT",
            1_660_212_248,
            "186631d0736c4dd933676be5a47d492d4354f796e18526d174535b1ae96f1335",
        ),
    ),
    "imagedream": (
        WeightFile(
            _IMAGEDREAM,
            "unet/diffusion_pytorch_model.safetensors",
            _IPMV,
            1_883_435_904,
            "28d8b241a54125fa0a041c1818a5dcdb717e6f5270eea1268172acd3ab0238e0",
        ),
        WeightFile(
            _IMAGEDREAM,
            "image_encoder/model.safetensors",
            _IPMV,
            1_261_595_704,
            "2a56cfd4ffcf40be097c430324ec184cc37187f6dafef128ef9225438a3c03c4",
        ),
        WeightFile(_IMAGEDREAM, "text_encoder/model.safetensors", _IPMV, 680_820_392),
        WeightFile(_IMAGEDREAM, "vae/diffusion_pytorch_model.safetensors", _IPMV, 167_335_342),
    ),
    "zero123": tuple(
        WeightFile(_ZERO123_REPO, path, _ZERO123)
        for path in (
            "unet/diffusion_pytorch_model.fp16.safetensors",
            "vae/diffusion_pytorch_model.fp16.safetensors",
            "image_encoder/model.fp16.safetensors",
            "clip_camera_projection/diffusion_pytorch_model.fp16.safetensors",
        )
    ),
    "clip": tuple(
        WeightFile("laion/CLIP-ViT-B-32-laion2B-s34B-b79K", path, "MIT")
        for path in ("config.json", "model.safetensors")
    ),
    "triposr": (
        WeightFile(_TRIPOSR_Q8, "triplane_q8.onnx", "MIT", 885_712),
        WeightFile(_TRIPOSR_Q8, "triplane_q8.onnx.data", "MIT", 483_785_728),
        WeightFile(_TRIPOSR_Q8, "decoder.onnx", "MIT", 173_796),
    ),
    "triposr-int8": tuple(
        WeightFile("fernandotonon/QtMeshEditor-triposr-onnx", path, "MIT")
        for path in ("triposr_encoder_int8.onnx", "triposr_decoder.onnx")
    ),
    "triposr-torch": (WeightFile("stabilityai/TripoSR", "model.ckpt", "MIT"),),
    "birefnet-lite": (WeightFile("onnx-community/BiRefNet_lite-ONNX", "onnx/model.onnx", "MIT"),),
    "birefnet-lite-512": (WeightFile("studioludens/birefnet-lite-512", "onnx/model.onnx", "MIT"),),
    "isnet": (
        WeightFile(
            _MIRROR,
            "isnet-general-use.onnx",
            "Apache-2.0 (DIS; no separate statement for the weights)",
            178_648_008,
            "60920e99c45464f2ba57bee2ad08c919a52bbf852739e96947fbb4358c0d964a",
        ),
    ),
    "moge2": (WeightFile("Ruicheng/moge-2-vits-normal-onnx", "model.onnx", "MIT"),),
    "depth-anything": (
        WeightFile("onnx-community/depth-anything-v2-small", "onnx/model.onnx", "Apache-2.0"),
    ),
}
"""Weight files by the name of their set."""


@dataclass(frozen=True)
class About:
    """The purpose of a set of weights."""

    brings: str
    megabytes: int
    """Approximate size of the download [MB]."""
    extra: str | None = None
    """Optional extra of phy124 that runs the network."""
    use: str = ANYWHERE
    memory: float = 0.0
    """Measured memory of a process that runs the network [bytes]; 0: not measured."""
    work: float = 0.0
    """Measured work for one picture, in operations of a float32 matrix product; 0: not measured."""


ABOUT: dict[str, About] = {
    "u2net": About("cuts objects out: --foreground u2net", 176),
    "u2netp": About("cuts objects out: --foreground u2netp; part of phy124", 5),
    "isnet": About(
        "cuts objects out, with fine edges: --foreground isnet",
        179,
        "onnx",
        memory=1.2e9,
        work=0.18e12,
    ),
    "birefnet-lite": About(
        "cuts objects out, with the finest edges: --foreground birefnet",
        224,
        "onnx",
        memory=5e9,
        work=0.8e12,
    ),
    "birefnet-lite-512": About(
        "cuts objects out, faster and coarser: --foreground birefnet-512",
        183,
        "onnx",
        memory=2e9,
        work=0.26e12,
    ),
    "moge2": About(
        "depth and normals of the front for relief: --depth moge2",
        148,
        "onnx",
        memory=2e9,
        work=0.39e12,
    ),
    "depth-anything": About(
        "depth of the front for relief: --depth depth-anything",
        99,
        "onnx",
        memory=0.6e9,
        work=0.15e12,
    ),
    "triposr": About(
        "an object with its unseen sides: --generator triposr",
        485,
        "onnx",
        memory=2.6e9,
        work=1.54e12,
    ),
    "triposr-int8": About(
        "the same network, all in 8 bits: --generator triposr",
        430,
        "onnx",
        memory=2.4e9,
        work=1.31e12,
    ),
    "triposr-torch": About(
        "the same network in float32: --generator triposr", 1680, "lgm", memory=2.8e9, work=3.6e12
    ),
    "lgm": About("65,536 Gaussians from four views: --generator lgm", 830, "lgm"),
    "lgm-fp32": About("LGM in float32, in place of lgm", 1660, "lgm"),
    "imagedream": About("the four views that lgm needs", 3993, "lgm", OPENRAIL),
    "zero123": About("guides --generator dreamgaussian", 3400, "dreamgaussian"),
    "clip": About("the measures of similarity of `phy124 evaluate`", 605, "eval"),
}
