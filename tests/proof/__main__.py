"""`python -m tests.proof NAME …`: one program of the proof, or the list of them."""

from __future__ import annotations

import importlib
import sys

from softdyn.commands import cli

PROGRAMS = (
    "fuzz", "robots", "pairs", "planted", "textbook", "closed_forms", "peer", "field",
    "compare_steps", "scaling", "twins", "poses", "scenes", "estimates.forces", "tables",
    "pictures",
)  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run one program, or list them; returns the exit code."""
    name, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    places = {place.split(".")[-1]: f"tests.proof.{place}" for place in PROGRAMS}
    if name in ("-h", "--help"):
        print("usage: python -m tests.proof NAME …\n")
        for known, place in places.items():
            about = importlib.import_module(place).__doc__ or ""
            print(f"  {known.replace('_', '-'):15}{about.splitlines()[0]}")
        return cli.PASSED
    if name.replace("-", "_") not in places:
        print(f"error: program: expected one of {', '.join(places)}, got {name}", file=sys.stderr)
        return cli.BAD_INPUT
    module = importlib.import_module(places[name.replace("-", "_")])
    module.parser.prog = f"python -m tests.proof {name}"
    code: int = module.main(rest)
    return code


if __name__ == "__main__":
    sys.exit(main())
