"""Time a published SoRoMoX rollout; runs in the peers' environment, without softdyn.

    python soromox_rod.py SCRIPT.py SECONDS RUNS OUT.npz

The script runs as published, but for another length of the rollout, and it draws and saves nothing.
Its rollout is then repeated, so that it needs no compiling.
"""

from __future__ import annotations

import re
import sys
import time
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock, patch

import jax
import numpy as np

# what the scripts draw with
DRAWING = ("cv2", "matplotlib", "matplotlib.pyplot", "soromox.rendering")


def roll(script: dict[str, Any]) -> float:
    """Time (s) of the script's rollout, from its own variables."""
    options = {name: script[name] for name in ("u", "t1", "solver_dt", "save_dt")}
    if "solver" in script:
        options["solver"] = script["solver"]
    began = time.perf_counter()
    found = script["robot"].rollout_to(
        initial_state=script["initial_state"], max_steps=None, **options
    )
    jax.block_until_ready(found.y)
    return time.perf_counter() - began


def main() -> None:
    """Run the script once, then its rollout as often as asked."""
    name, seconds, runs, out = sys.argv[1:]
    text, count = re.subn(r"\bt1 = 3(\.0)?$", f"t1 = {seconds}", Path(name).read_text(), flags=re.M)
    if count != 1:
        sys.exit(f"{name}: expected one line t1 = 3, got {count}")
    script: dict[str, Any] = {"__name__": "__main__", "__file__": name}
    with (
        patch.dict(sys.modules, {module: MagicMock() for module in DRAWING}),
        patch.object(np, "savetxt", lambda *_, **__: None),
    ):
        exec(compile(text, name, "exec"), script)
    first, *walls = (roll(script) for _ in range(int(runs) + 1))
    np.savez(out, wall=walls, first=first)


if __name__ == "__main__":
    main()
