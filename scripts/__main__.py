"""`softdyn NAME …`: every command under one name, listed by what one wants to do."""

from __future__ import annotations

import difflib
import importlib
import sys

from softdyn._version import __version__
from softdyn.commands import cli

COMMANDS = {
    "look at a robot": ("check_urdf", "crosscheck", "compare", "export", "view", "statics"),
    "close the loop": ("run", "replay", "obstacle"),
    "many loops": ("benchmark", "sweep", "robustness", "hold", "beyond", "tune", "reproduce"),
    "time and break": ("step_time", "compare_steps", "worst_step", "fuzz"),
    "made by a command": ("make_robots", "pictures"),
}


def main(argv: list[str] | None = None) -> int:
    """Run one command, or list them; returns the exit code."""
    name, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if name in ("-h", "--help"):
        print(listing())
        return cli.PASSED
    if name in ("-V", "--version"):
        print(f"softdyn {__version__}")
        return cli.PASSED
    names = [command for group in COMMANDS.values() for command in group]
    module_name = name.replace("-", "_")
    if module_name not in names:
        near = difflib.get_close_matches(module_name, names, 1)
        expected = f"{spelt(near[0])}?" if near else "a command; `softdyn` lists them"
        print(f"error: command: expected {expected}, got {name}", file=sys.stderr)
        return cli.BAD_INPUT
    module = importlib.import_module(f"softdyn.commands.{module_name}")
    module.parser.prog = f"softdyn {name}"
    code: int = module.main(rest)
    return code


def listing() -> str:
    """All commands with the first line of what each does."""
    lines = ["usage: softdyn COMMAND …        softdyn COMMAND --help", ""]
    for purpose, names in COMMANDS.items():
        lines.append(f"{purpose}:")
        for name in names:
            about = importlib.import_module(f"softdyn.commands.{name}").__doc__ or ""
            lines.append(f"  {spelt(name):12} {about.splitlines()[0]}")
        lines.append("")
    return "\n".join([*lines, f"softdyn {__version__}"])


def spelt(name: str) -> str:
    """A module's name as one types it."""
    return name.replace("_", "-")


if __name__ == "__main__":
    sys.exit(main())
