"""A differentiable rasteriser of 3D Gaussians, used to fit Gaussians to images.

Sources: Kerbl et al. 2023, "3D Gaussian Splatting"; the projection follows Zwicker et al. 2002
(EWA). This reference implementation in torch is suitable for small images on the CPU. On CUDA
devices, gsplat (the extra `gpu`) is used if it is installed.
"""

import importlib.util
import warnings
from dataclasses import dataclass

import torch
from torch import Tensor

from phy124.generators.neural.orbit import focal, orbit, to_opencv
from phy124.runtime.installation import install_command

TILE = 16
"""Side of a tile [pixels]."""
BLUR = 0.3
"""Variance added to each Gaussian on the screen [pixels^2]; no Gaussian is narrower than about a
pixel.
"""
NEAR = 0.01
ALPHA_MIN, ALPHA_MAX = 1 / 255, 0.99
STOP = 1e-4
"""Compositing of a pixel ends below this transmittance."""
GUARD = 1.3
"""Largest distance from the image centre at which the projection's Jacobian is evaluated, relative
to half the field of view. Farther out, the Jacobian would become very large.
"""


SLOW = (
    f"Rendering takes many times longer than with gsplat; `{install_command('gpu')}` installs "
    "gsplat."
)


@dataclass(frozen=True)
class View:
    """A pinhole camera with square pixels and the principal point at the image centre."""

    matrix: Tensor
    """World-to-camera transform [4,4]; x right, y down, z forward."""
    focal: float
    """Focal length [pixels]."""
    width: int
    height: int


@dataclass(frozen=True)
class Rendering:
    """A rendered image, and data for densification."""

    rgb: Tensor
    """Colours [H,W,3] over the background."""
    alpha: Tensor
    """Alpha [H,W], 0..1."""
    centres: Tensor
    """Projected centres [N,2], pixels; the backward pass stores the loss's gradient in `grad`."""
    radii: Tensor
    """Radius of three standard deviations on screen [N], pixels; 0 for invisible Gaussians."""

    def screen_gradients(self) -> Tensor:
        """Return the loss's gradients [N,2] with respect to the centres, in units of half the
        image.
        """
        height, width = self.alpha.shape
        gradient = self.centres.grad
        if gradient is None:
            gradient = torch.zeros_like(self.centres)
        return gradient.reshape(-1, 2) * gradient.new_tensor([width / 2, height / 2])


def rasterize(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    view: View,
    background: Tensor,
) -> Rendering:
    """Render Gaussians; the result is differentiable.

    Args:
        means: Centres [N,3].
        quats: Quaternions wxyz [N,4] of any length.
        scales: Standard deviations [N,3].
        opacities: Opacities [N], 0..1.
        colors: Colours [N,3].
        view: The camera.
        background: Colour [3] behind the Gaussians.
    """
    if means.is_cuda:
        if importlib.util.find_spec("gsplat"):
            return _with_gsplat(means, quats, scales, opacities, colors, view, background)
        warnings.warn(SLOW, stacklevel=2)
    centres, depths, covariances = project(means, quats, scales, view)
    if centres.requires_grad:
        centres.retain_grad()
    conics, radii = _conics(covariances, depths)
    with torch.no_grad():
        reach = _reach(covariances, opacities) * (radii > 0)
        radii = radii * _on_screen(centres, radii, view)
        order = torch.argsort(depths)
        order = order[reach[order] > 0]
    rgb, alpha = _tiles(centres, conics, opacities, colors, reach, order, view)
    return Rendering(rgb + (1 - alpha)[..., None] * background, alpha, centres, radii)


def rotation_matrices(quats: Tensor) -> Tensor:
    """Return rotation matrices [N,3,3] for quaternions wxyz [N,4] of any length."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def project(
    means: Tensor, quats: Tensor, scales: Tensor, view: View
) -> tuple[Tensor, Tensor, Tensor]:
    """Project Gaussians onto the screen.

    Args:
        means: Centres [N,3].
        quats: Quaternions wxyz [N,4].
        scales: Standard deviations [N,3].
        view: The camera.

    Returns:
        Centres [N,2] in pixels, depths [N], and covariances on screen [N,2,2] in pixels^2.
    """
    rotation = view.matrix[:3, :3].to(means)
    x, y, z = (means @ rotation.T + view.matrix[:3, 3].to(means)).unbind(-1)
    depth = z.clamp(min=NEAR)
    middle = means.new_tensor([view.width / 2, view.height / 2])
    centres = view.focal * torch.stack([x / depth, y / depth], dim=-1) + middle
    limit_x, limit_y = GUARD * view.width / 2 / view.focal, GUARD * view.height / 2 / view.focal
    u, v = (x / depth).clamp(-limit_x, limit_x), (y / depth).clamp(-limit_y, limit_y)
    zero = torch.zeros_like(u)
    jacobian = torch.stack(
        [
            torch.stack([1 / depth, zero, -u / depth], -1),
            torch.stack([zero, 1 / depth, -v / depth], -1),
        ],
        dim=-2,
    )
    axes = view.focal * jacobian @ rotation @ (rotation_matrices(quats) * scales[:, None, :])
    blur = BLUR * torch.eye(2, dtype=means.dtype, device=means.device)
    return centres, z, axes @ axes.transpose(1, 2) + blur


def _conics(covariances: Tensor, depths: Tensor) -> tuple[Tensor, Tensor]:
    """Return inverse covariances (xx, xy, yy) [N,3] and radii of three standard deviations [N]."""
    a, b, c = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    determinant = a * c - b * b
    conics = torch.stack([c, -b, a], dim=-1) / determinant[:, None]
    with torch.no_grad():
        middle = (a + c) / 2
        largest = middle + torch.sqrt((middle * middle - determinant).clamp(min=0.1))
        radii = torch.ceil(3 * largest.sqrt()) * (depths > NEAR)
    return conics, radii


def _on_screen(centres: Tensor, radii: Tensor, view: View) -> Tensor:
    size = centres.new_tensor([view.width, view.height])
    low, high = centres - radii[:, None], centres + radii[:, None]
    return ((high > 0) & (low < size)).all(dim=1)


def _reach(covariances: Tensor, opacities: Tensor) -> Tensor:
    """Return half the side [N] of the square outside which alpha is below `ALPHA_MIN`."""
    variance = covariances.diagonal(dim1=1, dim2=2).amax(dim=1)
    return (2 * torch.log((opacities / ALPHA_MIN).clamp(min=1)) * variance).sqrt()


def _tiles(
    centres: Tensor,
    conics: Tensor,
    opacities: Tensor,
    colors: Tensor,
    reach: Tensor,
    order: Tensor,
    view: View,
) -> tuple[Tensor, Tensor]:
    """Return colours [H,W,3] over black and alpha [H,W]; `order` is from near to far."""
    rows = []
    low, high = (
        (centres.detach() - reach[:, None])[order],
        (centres.detach() + reach[:, None])[order],
    )
    for top in range(0, view.height, TILE):
        band = (high[:, 1] >= top) & (low[:, 1] <= top + TILE)
        row = []
        for left in range(0, view.width, TILE):
            here = order[band & (high[:, 0] >= left) & (low[:, 0] <= left + TILE)]
            size = (min(TILE, view.height - top), min(TILE, view.width - left))
            pixels = _pixel_centres(left, top, size, centres)
            blended = _blend(pixels, centres[here], conics[here], opacities[here], colors[here])
            row.append(blended.reshape(*size, 4))
        rows.append(torch.cat(row, dim=1))
    image = torch.cat(rows, dim=0)
    return image[..., :3], image[..., 3]


def _pixel_centres(left: int, top: int, size: tuple[int, int], like: Tensor) -> Tensor:
    y = torch.arange(top, top + size[0], dtype=like.dtype, device=like.device) + 0.5
    x = torch.arange(left, left + size[1], dtype=like.dtype, device=like.device) + 0.5
    return torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1).reshape(-1, 2)


def _blend(
    pixels: Tensor, centres: Tensor, conics: Tensor, opacities: Tensor, colors: Tensor
) -> Tensor:
    """Return colour and alpha [P,4] at pixels [P,2]; Gaussians are sorted from near to far."""
    d = pixels[:, None, :] - centres
    xx, xy, yy = conics.unbind(-1)
    power = -0.5 * (xx * d[..., 0] ** 2 + yy * d[..., 1] ** 2) - xy * d[..., 0] * d[..., 1]
    alpha = (opacities * torch.exp(power)).clamp(max=ALPHA_MAX)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
    passed = torch.cumprod(1 - alpha, dim=1)
    before = torch.cat([torch.ones_like(passed[:, :1]), passed[:, :-1]], dim=1)
    weights = torch.where(passed >= STOP, alpha * before, torch.zeros_like(alpha))
    return torch.cat([weights @ colors, weights.sum(dim=1, keepdim=True)], dim=1)


def _with_gsplat(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    view: View,
    background: Tensor,
) -> Rendering:
    import gsplat  # pyright: ignore[reportMissingImports]

    f = view.focal
    intrinsics = means.new_tensor([[f, 0, view.width / 2], [0, f, view.height / 2], [0, 0, 1]])
    rgb, alpha, info = gsplat.rasterization(
        means,
        torch.nn.functional.normalize(quats, dim=-1),
        scales,
        opacities,
        colors,
        view.matrix.to(means)[None],
        intrinsics[None],
        view.width,
        view.height,
        near_plane=NEAR,
        backgrounds=background[None],
        packed=False,
    )
    centres = info["means2d"]
    if centres.requires_grad:
        centres.retain_grad()
    return Rendering(
        rgb[0], alpha[0, ..., 0], centres, info["radii"].float().reshape(len(means), -1).amax(1)
    )


def orbit_view(elevation: float, azimuth: float, radius: float, size: int) -> View:
    """Return a square view from a camera pose of `orbit`.

    Args:
        elevation: Elevation [degrees]; a positive angle is below the object.
        azimuth: Azimuth [degrees].
        radius: Distance of the camera from the origin.
        size: Width and height of the image [pixels].
    """
    matrix = torch.from_numpy(to_opencv(orbit(elevation, azimuth, radius))).float()
    return View(matrix, focal(size), size, size)
