"""The arguments that the pieces share."""

import argparse


def device_asked(about: str | None, count: int = 0) -> argparse.Namespace:
    """`--device`, and `--count` if there is a usual one."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--device", default="cuda:0")
    if count:
        parser.add_argument("--count", type=int, default=count, help="particles or Gaussians")
    return parser.parse_args()
