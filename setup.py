"""Leaves two empty files out of a wheel; everything else about the build is in pyproject.toml.

Other distributions hold `agents/__init__.py` or `baselines/__init__.py` as well. If a wheel of this
project held them, uninstalling it would remove theirs. Python needs no `__init__.py` to import from a
folder; `shake_env.command_line` says what to do where another distribution's is in the way.
"""

from setuptools import setup
from setuptools.command.build_py import build_py

SHARED = ("agents", "baselines")  # names of packages that other distributions have as well


class BuildWithoutSharedFiles(build_py):
    """Builds all modules but the empty `__init__.py` of packages whose names others have."""

    def find_package_modules(self, package, package_dir):
        """Return (package, module, file) of what is built."""
        found = super().find_package_modules(package, package_dir)
        return [each for each in found if not (package in SHARED and each[1] == "__init__")]


setup(cmdclass={"build_py": BuildWithoutSharedFiles})
