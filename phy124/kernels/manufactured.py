"""Body forces that make a chosen motion an exact solution (method of manufactured solutions).

The generalised vortex of Kamojjala, Brannon, Sadeghirad, Guilkey 2015 (doi
10.1007/s00366-013-0342-x): each radius of a ring rotates by beta(R, t) = h(R) g(t) about z,

    h = 1 - 8 s^2 + 16 s^4, s = (R - mean) / width,   g = A (1 - cos(2 pi t)) / 2.

For a neo-Hookean solid tau = mu (b - I) + lambda ln(J) I of density rho, with gamma = R beta',
the force per mass is -R beta_t^2 + mu gamma^2 / (rho R) in the radial direction and
R beta_tt - mu (3 beta' + R beta'') / rho in the tangential one. Both edges of the ring remain free
of stress.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import kernel


@cache
def make_vortex(real: Any):
    """Kernel over the particles, before they scatter: v += kick b(x, t).

    `ring` is (mean radius [m], width [m], A [rad], mu / rho [m^2/s^2]).
    """
    t = types(real)

    @kernel(f"phy124_vortex_{real.__name__}", real)
    def vortex(ring: t.vec4, clock, x, v_out):
        p = wp.tid()
        along_x = x[p][0]
        along_y = x[p][1]
        r = wp.sqrt(along_x * along_x + along_y * along_y)
        s = (r - ring[0]) / ring[1]
        two_pi = real(6.283185307179586)
        g = real(0.5) * ring[2] * (real(1.0) - wp.cos(two_pi * clock[2]))
        g_t = real(0.5) * ring[2] * two_pi * wp.sin(two_pi * clock[2])
        g_tt = real(0.5) * ring[2] * two_pi * two_pi * wp.cos(two_pi * clock[2])
        s2 = s * s
        h = real(1.0) - real(8.0) * s2 + real(16.0) * s2 * s2
        h_r = (real(-16.0) * s + real(64.0) * s2 * s) / ring[1]
        h_rr = (real(-16.0) + real(192.0) * s2) / (ring[1] * ring[1])
        gamma = r * h_r * g
        speed = h * g_t
        outwards = -r * speed * speed + ring[3] * gamma * gamma / r
        around = r * h * g_tt - ring[3] * (real(3.0) * h_r + r * h_rr) * g
        push = wp.vector(
            (outwards * along_x - around * along_y) / r,
            (outwards * along_y + around * along_x) / r,
            real(0.0),
        )
        v_out[p] = v_out[p] + clock[0] * push

    return vortex
