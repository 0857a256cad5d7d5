"""The bridge: a clip's Gaussians as ROS 2 topics and MCAP files.

Nothing here is imported by phy124. Everything but `sinks/` needs NumPy and pydantic only; each
sink imports its own library when it is opened.
"""

PROGRAM = "python -m bridge" if __name__ == "bridge" else "phy124-bridge"
"""What a user types: in a checkout, and where this folder is installed as `phy124_bridge`."""
