"""`softdyn NAME …`: every command under one name, listed by what one wants to do."""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import sys

from softdyn._version import __version__
from softdyn.commands import cli

# by what one wants to do
COMMANDS = {
    "begin": ("examples", "new", "identify", "compile"),
    "see what a robot's file amounts to": ("check", "view", "statics", "converge"),
    "compare it with another engine or file": ("crosscheck", "compare", "export"),
    "close one loop and look at it": ("run", "play", "replay", "obstacle"),
    "choose a controller and its gains": ("sweep", "tune", "robustness"),
    "repeat the paper and go beyond it": ("benchmark", "reproduce", "hold", "beyond", "certify"),
    "time the control step": ("step_time", "worst_step"),
}
NAMES = [name for names in COMMANDS.values() for name in names]


def main(argv: list[str] | None = None) -> int:
    """Run one command, or list them; returns the exit code."""
    if "_ARGCOMPLETE" in os.environ:
        complete()
    name, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if name in ("-h", "--help"):
        print(listing())
        return cli.PASSED
    if name in ("-V", "--version"):
        print(f"softdyn {__version__}")
        return cli.PASSED
    module_name = name.replace("-", "_")
    if module_name not in NAMES:
        near = difflib.get_close_matches(module_name, NAMES, 1)
        expected = f"{spelt(near[0])}?" if near else "a command; `softdyn` lists them"
        print(f"error: command: expected {expected}, got {name}", file=sys.stderr)
        return cli.BAD_INPUT
    module = importlib.import_module(f"softdyn.commands.{module_name}")
    module.parser.prog = f"softdyn {spelt(module_name)}"
    code: int = module.main(rest)
    return code


def complete() -> None:
    """Answer the shell, which asks how a line may go on: `argcomplete` does it."""
    import argcomplete

    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers()
    for name in NAMES:
        typed = spelt(name) in os.environ.get("COMP_LINE", "").split()
        parents = [importlib.import_module(f"softdyn.commands.{name}").parser] if typed else []
        commands.add_parser(spelt(name), parents=parents, add_help=False)
    argcomplete.autocomplete(parser)


def listing() -> str:
    """All commands with the first line of what each does."""
    lines = ["usage: softdyn COMMAND …        softdyn COMMAND --help", ""]
    for purpose, names in COMMANDS.items():
        lines.append(f"{purpose}:")
        for name in names:
            about = importlib.import_module(f"softdyn.commands.{name}").__doc__ or ""
            lines.append(f"  {spelt(name):14}{about.splitlines()[0]}")
        lines.append("")
    return "\n".join([*lines, f"softdyn {__version__}"])


def spelt(name: str) -> str:
    """A module's name as one types it."""
    return name.replace("_", "-")


if __name__ == "__main__":
    sys.exit(main())
