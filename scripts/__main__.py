"""`softdyn NAME …`: all commands under one name, listed by purpose."""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import sys

from softdyn._version import __version__
from softdyn.commands import cli

# # by purpose
COMMANDS = {
    "begin": ("examples", "new", "identify", "compile"),
    "examine a robot": ("check", "view", "statics", "observe", "converge"),
    "compare it with another engine or file": ("crosscheck", "compare", "export"),
    "run one closed loop and look at it": ("run", "rollout", "play", "replay", "obstacle"),
    "choose a controller and its gains": ("sweep",),
    "repeat the paper and go beyond it": ("benchmark", "reproduce", "certify"),
    "time the control step": ("step_time",),
}
# command of earlier versions → its present name
MOVED = {
    "beyond": "softdyn sweep periods",
    "compare_steps": "python -m tests.proof compare-steps, in a checkout",
    "fuzz": "python -m tests.proof fuzz, in a checkout",
    "hold": "softdyn sweep horizon",
    "make_robots": "python urdf/make_robots.py, in a checkout",
    "pictures": "python -m tests.proof pictures, in a checkout",
    "robustness": "softdyn sweep robustness",
    "tables": "python -m tests.proof tables, in a checkout",
    "textbook": "python -m tests.proof textbook, in a checkout",
    "twins": "python -m tests.proof twins, in a checkout",
    "worst_step": "softdyn step-time --hostile",
}
NAMES = [name for names in COMMANDS.values() for name in names]


def main(argv: list[str] | None = None) -> int:
    """Run one command, or list them; return the exit code."""
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
        if module_name in MOVED:
            print(f"error: command: {name} is now {MOVED[module_name]}", file=sys.stderr)
            return cli.BAD_INPUT
        near = difflib.get_close_matches(module_name, NAMES, 1)
        expected = f"{spelt(near[0])}?" if near else "a command; `softdyn` lists them"
        print(f"error: command: expected {expected}, got {name}", file=sys.stderr)
        return cli.BAD_INPUT
    module = importlib.import_module(f"softdyn.commands.{module_name}")
    module.parser.prog = f"softdyn {spelt(module_name)}"
    code: int = module.main(rest)
    return code


def complete() -> None:
    """Complete a command line for the shell, by `argcomplete`."""
    import argcomplete

    parser = argparse.ArgumentParser()
    commands = parser.add_subparsers()
    for name in NAMES:
        typed = spelt(name) in os.environ.get("COMP_LINE", "").split()
        parents = [importlib.import_module(f"softdyn.commands.{name}").parser] if typed else []
        commands.add_parser(spelt(name), parents=parents, add_help=False)
    argcomplete.autocomplete(parser)


def listing() -> str:
    """All commands with the first line of their descriptions."""
    lines = ["usage: softdyn COMMAND …        softdyn COMMAND --help", ""]
    for purpose, names in COMMANDS.items():
        lines.append(f"{purpose}:")
        for name in names:
            about = importlib.import_module(f"softdyn.commands.{name}").__doc__ or ""
            lines.append(f"  {spelt(name):14}{about.splitlines()[0]}")
        lines.append("")
    return "\n".join([*lines, f"softdyn {__version__}"])


def spelt(name: str) -> str:
    """A module's name as a command."""
    return name.replace("_", "-")


if __name__ == "__main__":
    sys.exit(main())
