"""The computing device, by the name a user gives it."""

from __future__ import annotations

from phy124.errors import InputError

CHOICES = "auto, cpu or cuda:0."
"""The names a user may give, for every option that takes a device."""


def pick_device(name: str) -> str:
    """Warp's name of the device; "auto" is CUDA if there is one.

    Raises:
        InputError: If there is no such device.
    """
    import warp as wp

    from phy124.runtime import startup

    startup.start()
    if name == "auto":
        return "cuda:0" if wp.is_cuda_available() else "cpu"
    known = [str(device) for device in wp.get_devices()]
    if name not in known:
        raise InputError(
            "device", name, "this machine has no such device.", f"Choose {' or '.join(known)}."
        )
    return name
