"""Checks that the engines are those that were installed with softdyn."""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

from packaging.requirements import Requirement

from softdyn.exceptions import InputError

# modules and the packages that bring them
ENGINES = {"pinocchio": "pin", "proxsuite": "proxsuite", "mujoco": "mujoco"}


@cache
def check_engines() -> None:
    """Refuse an engine of another installation, or of a version that softdyn does not know.

    PYTHONPATH may put another copy before the installed one, for example after the set-up script
    of ROS was sourced. An engine whose package is not installed is not judged: other package
    managers bring it under other names.

    Raises
    ------
    InputError
        If an engine would be imported from another place than its package, or if its version is
        outside the range that softdyn states.
    """
    ranges = _ranges()
    for module, package in ENGINES.items():
        file = sys.modules[module].__file__ if module in sys.modules else _file(module)
        try:
            installed = distribution(package)
        except PackageNotFoundError:
            continue
        home = Path(str(installed.locate_file(""))).resolve()
        remedy = "unset PYTHONPATH, or use a shell that has not sourced another set-up script"
        if file is None or not Path(file).resolve().is_relative_to(home):
            expected = f"the one of {package} {installed.version} in {home}"
            raise InputError(f"import {module}", f"{expected} ({remedy})", file)
        if package in ranges and not ranges[package].specifier.contains(installed.version):
            expected = f"{package} {ranges[package].specifier} (install it; or {remedy})"
            raise InputError(f"import {module}", expected, f"{installed.version} in {home}")


def _file(module: str) -> str | None:
    """The file that an import of the module would run."""
    found = find_spec(module)
    return None if found is None else found.origin


def _ranges() -> dict[str, Requirement]:
    """The versions of each package that softdyn's own metadata admit."""
    try:
        lines = distribution("softdyn").requires or ()
    except PackageNotFoundError:  # a folder on sys.path that nobody installed
        return {}
    return {one.name: one for one in map(Requirement, lines) if one.marker is None}
