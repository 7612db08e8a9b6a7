"""The page of commands, from the commands themselves."""

import importlib

from mkdocs.structure.files import File, Files

from softdyn.commands.__main__ import COMMANDS, spelt


def on_files(files: Files, config) -> Files:
    """Add commands.md: what `softdyn NAME --help` says, command by command."""
    files.append(File.generated(config, "commands.md", content=commands()))
    return files


def commands() -> str:
    """The page as Markdown."""
    lines = ["# Commands", "", "`softdyn NAME --help` prints these texts.", ""]
    for purpose, names in COMMANDS.items():
        lines += [f"## {purpose.capitalize()}", ""]
        for name in names:
            parser = importlib.import_module(f"softdyn.commands.{name}").parser
            parser.prog = f"softdyn {spelt(name)}"
            lines += [f"### {spelt(name)}", "", "```text", parser.format_help().rstrip(), "```", ""]
    return "\n".join(lines)
