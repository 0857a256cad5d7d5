"""The steps from noise to latents: the schedule, and the solvers that follow it.

DDIM (Song et al. 2021) is of first order, DPM-Solver++ (Lu et al. 2022) of second. Both solve the
same equation, so both tend to the same latents; docs/lab/benchmarks.md compares their errors.
"""

from __future__ import annotations

from typing import Any

from diffusers.schedulers.scheduling_ddim import DDIMScheduler
from diffusers.schedulers.scheduling_dpmsolver_multistep import DPMSolverMultistepScheduler

from phy124.generators.options import Sampler

NOISE: dict[str, Any] = {
    "beta_start": 0.00085,
    "beta_end": 0.012,
    "beta_schedule": "scaled_linear",
    "num_train_timesteps": 1000,
    "steps_offset": 1,
    "prediction_type": "epsilon",
    "timestep_spacing": "leading",
}
SCHEDULE = {**NOISE, "clip_sample": False, "set_alpha_to_one": False}
"""ImageDream's own, for DDIM."""


def scheduler_of(sampler: Sampler, steps: int) -> Any:
    """The scheduler of diffusers that takes so many steps, ready for the first."""
    if sampler == "ddim":
        scheduler: Any = DDIMScheduler(**SCHEDULE)
    else:
        # Its last step ends at the same little noise as DDIM's.
        scheduler = DPMSolverMultistepScheduler(
            **{**NOISE, "timestep_spacing": "linspace"},
            use_lu_lambdas=True,
            final_sigmas_type="sigma_min",
        )
    scheduler.set_timesteps(steps)
    return scheduler
