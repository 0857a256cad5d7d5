"""The bridge: a clip's Gaussians as ROS 2 topics and MCAP files.

Nothing here is imported by phy124. Everything but `sinks/` needs NumPy and pydantic only; each
sink imports its own library when it is opened.
"""
