"""Options of commands that run studies: ensembles, and a robot and gains of one's own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softdyn.commands import cli

if TYPE_CHECKING:
    from softdyn.validation.studies.engine.case import Case
    from softdyn.validation.studies.engine.distribution import Distribution
    from softdyn.validation.studies.engine.store import Executor, Store


def add_ensemble_options(parser: cli.Parser) -> None:
    """Add the options of `distributions`."""
    parser.add_argument(
        "--ensemble", type=cli.count, default=0, metavar="N",
        help="run every loop from 2 more starts (1e-9 apart), or N if its printed figure varies or "
        "it has noise or an observer, each with another seed of the rig",
    )  # fmt: skip
    parser.option("--seed", cli.whole, "S", "seed of the starts", 1)
    parser.output("--keep", "FILE", "add the figures to those of other seeds and cells in FILE")


def distributions(
    arguments: cli.Arguments, cells: Mapping[str, Case], store: Store | None = None,
    execute: Executor | None = None, folder: Path = Path(), depends: Sequence[str] = (),
    more: Callable[[dict[str, Distribution]], dict[str, Distribution]] = dict,
) -> dict[str, Distribution]:  # fmt: skip
    """Run the ensembles of `add_ensemble_options`; store them below --out, by default ensemble/.

    Relative paths are relative to `folder`; classes of one's own read files that they `depends` on.
    `more` adds further cells.
    """
    from softdyn.validation.studies.engine import distribution, ensemble, executors
    from softdyn.validation.studies.engine.store import Store

    store, keep = store or Store(Path(arguments.out), runs="ensemble"), Path(arguments.keep or "")
    execute = execute or executors.strict(arguments.jobs or -1)
    before = distribution.read_distributions(keep) if arguments.keep and keep.exists() else {}
    found = ensemble.run(cells, store, execute, arguments.ensemble, arguments.seed, before, folder,
                         depends)  # fmt: skip
    found |= more(found)
    both = distribution.join(before, found)
    if arguments.keep:
        distribution.write_distributions(keep, both)
    return {label: both[label] for label in found}


def summaries(cells: Mapping[str, Distribution]) -> dict[str, Any]:
    """Cells in the form of the commands' JSON."""
    return {"cells": {label: cell.summary() for label, cell in cells.items()}}


def add_own_options(parser: cli.Parser) -> None:
    """Add the options of a study of one own robot: its annotations, its controller's gains."""
    parser.add_argument("--annotations", metavar="FILE", help=cli.BLOCK)
    parser.add_argument("--gains", metavar="FILE", help="gains of the controller, a TOML file")


def own_gains(arguments: cli.Arguments) -> dict[str, Any] | None:
    """The gains' table of `add_own_options`, which needs a single robot."""
    from softdyn import InputError

    given = arguments.annotations or arguments.gains
    if given and len(getattr(arguments, "robots", [1])) > 1:
        raise InputError(given, "one robot to go with it", f"{len(arguments.robots)} robots")
    return cli.read_toml(arguments.gains) if arguments.gains else None
