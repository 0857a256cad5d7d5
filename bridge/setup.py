"""Set-up for `colcon build`, which builds this folder as the ROS 2 package phy124_bridge.

The package phy124 itself is installed with pip (docs/guide/ros2-package.md).
"""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import setup
from setuptools.command.develop import develop
from setuptools.command.install_scripts import install_scripts

PACKAGE = ElementTree.parse(Path(__file__).with_name("package.xml")).getroot()
NAME, VERSION, DESCRIPTION, LICENSE, MAINTAINER = (
    PACKAGE.findtext(tag, "") for tag in ("name", "version", "description", "license", "maintainer")
)
# This folder is the package. The path starts from the parent folder, because `colcon build
# --symlink-install` cannot link ".".
HERE = f"../{Path(__file__).resolve().parent.name}"
EXECUTABLES = {
    "player": (f"{NAME}.start", "player", 0),
    "managed": (f"{NAME}.start", "manage", 0),
    "simulate": (f"{NAME}.start", "simulate", 0),
    "live": (f"{NAME}.start", "live", 130),
    "bridge": (f"{NAME}.__main__", "main", 130),
}
"""For each script: its module, its function, and its exit status after Ctrl-C."""
SCRIPT = """{interpreter}
try:
    from {module} import {function}

    raise SystemExit({function}())
except KeyboardInterrupt:
    raise SystemExit({status}) from None
"""


def quick(command):
    """Return a setuptools command that writes `SCRIPT` for the executables of this package.

    The scripts of setuptools look up the package first; pressing Ctrl-C during this time shows a
    traceback.
    """

    class Quick(command):
        def write_script(self, script_name, contents, mode="t", *rest):
            if script_name in EXECUTABLES:
                module, function, status = EXECUTABLES[script_name]
                contents = SCRIPT.format(
                    interpreter=contents.splitlines()[0],
                    module=module,
                    function=function,
                    status=status,
                )
            super().write_script(script_name, contents, mode, *rest)

    return Quick


setup(
    name=NAME,
    version=VERSION,
    description=DESCRIPTION,
    license=LICENSE,
    maintainer=MAINTAINER,
    maintainer_email=PACKAGE.findall("maintainer")[0].get("email"),
    packages=[NAME, f"{NAME}.sinks", f"{NAME}.steering"],
    package_dir={NAME: HERE},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "LICENSE"]),
        (f"share/{NAME}/launch", ["launch/player.launch.py"]),
        (f"share/{NAME}/config", ["config/player.yaml"]),
        (f"share/{NAME}/rviz", ["rviz/phy124.rviz"]),
        (f"share/{NAME}/foxglove", ["foxglove/phy124.json"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # makes `colcon test` run pytest
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"{name} = {module}:{function}" for name, (module, function, _) in EXECUTABLES.items()
        ]
    },
    # `colcon build` uses install_scripts, `colcon build --symlink-install` uses develop.
    cmdclass={"install_scripts": quick(install_scripts), "develop": quick(develop)},
)
