"""The bridge: publishes a clip's Gaussians as ROS 2 topics and writes MCAP files.

phy124 imports nothing from this package. All modules outside `sinks/` need only NumPy and pydantic.
Each sink imports its own library when it is opened.
"""

PROGRAM = "python -m bridge" if __name__ == "bridge" else "phy124-bridge"
"""The command that starts the bridge, in a checkout or from an installed `phy124_bridge`."""
