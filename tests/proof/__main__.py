"""`python -m tests.proof NAME …`: one program of the proof, or the list of them."""

from __future__ import annotations

import importlib
import sys

from softdyn.commands import cli

PROGRAMS = (
    "fuzz", "robots", "pairs", "public_files", "planted", "textbook", "reproduce", "certify",
    "closed_forms", "peer", "field", "identification.second_opinion", "twins",
    "step_time", "hostile", "throughput", "observer_time", "loop_time", "live_time",
    "compare_steps", "scaling", "rig_faults",
    "rests", "poses", "scenes", "near_far", "barrier_time", "obstacle", "estimates.forces",
    "estimates.creep", "identification.decays",
    "tables", "pictures", "gallery", "batches", "episodes", "weights",
    "wraps", "discrete_steps", "shortest_way", "lost_cells", "pressed_arm",
)  # fmt: skip

# a program's name → its module
PLACES = {place.split(".")[-1]: f"tests.proof.{place}" for place in PROGRAMS}


def main(argv: list[str] | None = None) -> int:
    """Run one program, or list them; returns the exit code."""
    cli.one_thread()  # before a program imports NumPy
    name, *rest = (sys.argv[1:] if argv is None else argv) or ["--help"]
    if name in ("-h", "--help"):
        print("usage: python -m tests.proof NAME …\n")
        for known, place in PLACES.items():
            about = importlib.import_module(place).__doc__ or ""
            print(f"  {known.replace('_', '-'):15}{about.splitlines()[0]}")
        return cli.PASSED
    if name.replace("-", "_") not in PLACES:
        print(f"error: program: expected one of {', '.join(PLACES)}, got {name}", file=sys.stderr)
        return cli.BAD_INPUT
    module = importlib.import_module(PLACES[name.replace("-", "_")])
    module.parser.prog = f"python -m tests.proof {name}"
    code: int = module.main(rest)
    return code


if __name__ == "__main__":
    sys.exit(main())
