"""Under which names the folders are installed; everything else stands in pyproject.toml.

Other projects have folders called `demo` and `bridge`, too: nothing of that name is installed.
"""

from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
FOLDERS = {"phy124": "phy124", "phy124_demo": "demo", "phy124_bridge": "bridge"}
"""Installed package -> folder of the checkout."""


class BuildModules(build_py):
    """Leaves out bridge/setup.py, with which ROS 2 builds that folder.

    An editable install also puts the checkout on the path. Otherwise a script next to the checkout
    would import that folder, which is called phy124 as well, as an empty namespace package.
    """

    def run(self) -> None:
        """Build; in an editable install write the path of the checkout."""
        super().run()
        if self.editable_mode:
            folder = self.get_finalized_command("install").install_lib
            Path(folder, "phy124_checkout.pth").write_text(f"{ROOT}\n", "utf-8")

    def find_package_modules(self, package: str, package_dir: str) -> list[tuple[str, str, str]]:
        """Package, module and file of each module."""
        found = super().find_package_modules(package, package_dir)
        return [module for module in found if module[:2] != ("phy124_bridge", "setup")]


setup(
    cmdclass={"build_py": BuildModules},
    package_dir=FOLDERS,
    packages=[
        package.replace(folder, name, 1)
        for name, folder in FOLDERS.items()
        for package in find_packages(include=[folder, f"{folder}.*"])
    ],
)
