"""Helpers that tests share."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = ROOT / "scripts"
CORPUS = ROOT / "tests" / "corpus"
PATIENCE = 900.0  # s until a wait counts as endless, however busy the machine is
