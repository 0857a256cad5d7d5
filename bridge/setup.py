"""The ROS 2 package phy124_bridge: this folder, as `colcon build` wants it.

The package phy124 itself is installed with pip (docs/bridge.md).
"""

from pathlib import Path

from setuptools import setup

NAME = "phy124_bridge"
# This folder is the package itself. `colcon build --symlink-install` cannot link ".", so it is
# named from outside.
HERE = f"../{Path(__file__).resolve().parent.name}"

setup(
    name=NAME,
    version="0.1.0",
    description="phy124's moving Gaussians as ROS 2 topics and MCAP files",
    license="MIT",
    packages=[NAME, f"{NAME}.sinks"],
    package_dir={NAME: HERE},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/player.launch.py"]),
        (f"share/{NAME}/config", ["config/player.yaml"]),
        (f"share/{NAME}/rviz", ["rviz/phy124.rviz"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"player = {NAME}.node:main",
            f"live = {NAME}.node:live",
            f"bridge = {NAME}.__main__:main",
        ]
    },
)
