"""`softdyn NAME …`: all commands under one name, listed by purpose."""

from __future__ import annotations

import argparse
import importlib
import os
import sys

from softdyn._version import __version__
from softdyn.commands import cli

# by purpose
COMMANDS = {
    "begin": ("new", "attach", "identify", "compile"),
    "examine a robot": ("check", "view", "statics", "observe"),
    "compare it with another engine or file": ("crosscheck", "compare", "export"),
    "run one closed loop and look at it": ("run", "rollout", "play", "replay"),
    "drive a real rig": ("drive",),
    "run many": ("sweep",),
    "repeat the paper": ("benchmark",),
    "time the control step": ("step_time",),
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
        from softdyn.checks import did_you_mean
        from softdyn.exceptions import one_line

        got = did_you_mean(one_line(name), map(spelt, NAMES))
        expected = "a command that `softdyn` lists"
        print(f"error: command: expected {expected}, got {got}", file=sys.stderr)
        return cli.BAD_INPUT
    with cli.ends_at_once():
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
