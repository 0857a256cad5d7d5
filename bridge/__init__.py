"""The bridge: a clip's Gaussians as ROS 2 topics and MCAP files.

phy124 imports nothing from here. Everything except `sinks/` needs only NumPy and pydantic; each
sink imports its own library when it is opened.
"""

PROGRAM = "python -m bridge" if __name__ == "bridge" else "phy124-bridge"
"""The command a user types: in a checkout, or if this folder is installed as `phy124_bridge`."""
