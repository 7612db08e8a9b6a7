"""Cells as distributions: their runs, their text, and the committed figures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softdyn.validation.studies import benchmark
from softdyn.validation.studies.benchmark_table import benchmark_document
from softdyn.validation.studies.engine import distribution, ensemble
from softdyn.validation.studies.engine.case import Case
from softdyn.validation.studies.engine.distribution import Agreement, Distribution
from softdyn.validation.studies.engine.store import Store
from softdyn.validation.studies.engine.worker import CaseResult
from tests.support.refused import refused

STEADY = Case("finger", "ic", "set_point", 0.5)
CHAOTIC = Case("finger", "ic", "tracking", 0.5)
GONE = Case("finger", "uic", "tracking", 0.5)
NOISY = Case("finger", "ic", "set_point", 0.5, options={"rig": {"noise": 1e-3}})


class Made:
    """An executor that runs nothing; its figures depend on the draw, and some are missing."""

    def __init__(self) -> None:
        self.ran: list[Case] = []

    def __call__(self, order: list[Any]) -> Any:
        for index, job in enumerate(order):
            case = job.case
            self.ran.append(case)
            number = 0 if case.draw is None else case.draw[1] + 1
            mse = {CHAOTIC.controller: 3.0 + number, GONE.controller: None if number % 4 else 5.0}
            figures = {"final_error_cm": 0.125, "mse_cm2": mse[case.controller]}
            if isinstance(rig := case.options.get("rig"), dict):
                figures |= {"input_change_percent": 0.1 * (1 + rig.get("seed", 0) % 5)}
            if case is CHAOTIC or case.draw == (3, 0):
                figures |= {"second_cycle_mse_cm2": 0.5 + number}
            yield index, CaseResult({"outcome": "done", "failed": number == 2, **figures})


def run(folder: Path, seed: int = 1, **options: Any) -> tuple[dict[str, Distribution], list[Case]]:
    made, cells = Made(), {"steady": STEADY, "chaotic": CHAOTIC, "gone": GONE}
    return ensemble.run(cells, Store(folder), made, 8, seed, **options), made.ran


def test_only_what_moves_is_run_often(tmp_path: Path) -> None:
    found, ran = run(tmp_path)
    often = {case: sum(r.robot == case.robot and r.controller == case.controller
                       and r.kind == case.kind for r in ran)
             for case in (STEADY, CHAOTIC, GONE)}  # fmt: skip
    assert often == {STEADY: 1 + ensemble.SCREEN, CHAOTIC: 1 + 8, GONE: 1 + 8}
    assert found["steady"] == Distribution(0.125, {}, {"1": 1})
    assert found["chaotic"].values == (3.0, *np.arange(4.0, 12.0))
    assert found["chaotic"].text() == "~7.00 [3.00, 11.0]"
    assert found["gone"].text() == "~none [5.00, none]"
    # all results are kept: nothing runs twice; another seed only runs cells that depend on it
    assert run(tmp_path)[1] == []
    assert {case.draw[0] for case in run(tmp_path, seed=2)[1] if case.draw} == {2}


def test_noise_has_other_seeds_and_always_all_of_them(tmp_path: Path) -> None:
    made = Made()
    cell = ensemble.run({"noisy": NOISY}, Store(tmp_path), made, 4, 2)["noisy"]
    assert [case.options["rig"].get("seed", 0) for case in made.ran] == [0, 2001, 2002, 2003, 2004]
    assert {(case.nudge, case.draw) for case in made.ran} == {(0.0, None)}
    assert cell.seeds == {"2": (0.125,) * 4}  # a figure that stays has all its runs, too
    assert cell.input_change == Distribution(0.1, {"2": pytest.approx((0.2, 0.3, 0.4, 0.5))})


@pytest.mark.parametrize(
    "options",
    [{"rig": "file", "observer": ""}, {"rig": {"lag": 0.01}, "observer": "tip_force"},
     {"rig": {"bias": 1e-3}}],
    ids=["file", "table", "bias"],
)  # fmt: skip
def test_sensors_and_biases_have_other_seeds_too(options: dict[str, Any], tmp_path: Path) -> None:
    made, case = Made(), Case("finger", "ic", "set_point", 0.5, options=options)
    cell = ensemble.run({"observed": case}, Store(tmp_path), made, 4, 2)["observed"]
    assert made.ran[0].options["rig"] == options["rig"]
    said = options["rig"] if isinstance(options["rig"], dict) else {}
    wanted = [said | {"seed": k} for k in (2001, 2002, 2003, 2004)]
    assert [one.options["rig"] for one in made.ran[1:]] == wanted
    assert {one.options.get("observer") for one in made.ran} == {options.get("observer")}
    assert len({one.draw for one in made.ran}) == 5  # a loop without noise may be chaotic
    assert cell.seeds == {"2": (0.125,) * 4}


def test_trajectories_have_a_second_cycle_and_set_points_an_input_change(tmp_path: Path) -> None:
    cells = {"a/ω = 0.5π": CHAOTIC}
    found = ensemble.run(cells, Store(tmp_path), Made(), 1, 3)
    cell = found["a/ω = 0.5π"]
    assert cell.second_cycle == Distribution(0.5, {"3": (1.5,)})
    assert cell.input_change is None
    assert cell.pair() == "~3.50 [3.00, 4.00] / 1.00"
    assert cell.summary()["second_cycle"] == 1.0
    assert cell.constant().pair() == "3.00 / 0.50"
    held = Distribution(0.2, input_change=Distribution(0.5))
    shaky = Distribution(0.2, input_change=Distribution(1.5, {"1": (2.5, 9.0)}))
    table = distribution.pivot({"a/θ = 0π": held, "a/θ = 1π": shaky, **found}, ["law"], "mean")
    assert table.splitlines()[0] == "| law | θ = 0π | θ = 1π | ω = 0.5π | mean | Δu (%) |"
    assert table.splitlines()[2].endswith("| 0.20 | 0.20 | ~3.50 [3.00, 4.00] / 1.00 | "
                                          "~1.30 ± 1.56 [1.13, 1.47] | 2.50 |")  # fmt: skip
    mean, _ = distribution.mean_and_std([cell, cell])
    assert mean.second_cycle is not None
    assert mean.second_cycle.median == 1.0
    assert distribution.notes({"a": held}) == distribution.BESIDE["input_change"]
    assert distribution.notes(found).startswith(distribution.NOISY)
    assert distribution.notes({"a": Distribution(1.0)}) == ""
    # both survive their file, and the longer list of runs is kept
    path = tmp_path / "kept.json"
    distribution.write_distributions(path, found | {"b": shaky})
    again = distribution.read_distributions(path)
    assert again == found | {"b": shaky}
    joined = distribution.join(again, {"b": held, "a/ω = 0.5π": cell.constant()})
    assert joined["a/ω = 0.5π"] == cell
    assert joined["b"].input_change == Distribution(0.5, {"1": (2.5, 9.0)})


def test_starts_are_seeded_and_tiny() -> None:
    one, other = (case.start(36) for case in ensemble.members(STEADY, 2, 7))
    np.testing.assert_array_equal(one, ensemble.members(STEADY, 2, 7)[0].start(36))
    assert not np.allclose(one, other, rtol=1e-3, atol=0)
    assert 0 < np.abs(one).max() < 5e-9
    assert not STEADY.start(36).any()


def test_what_moved_with_another_seed_is_run_as_often(tmp_path: Path) -> None:
    known = {"steady": Distribution(0.125, {"1": (0.125, 2.0)})}
    found, ran = run(tmp_path, 2, known=known)
    assert sum(case.kind == "set_point" for case in ran) == 1 + 8
    assert found["steady"].seeds == {"2": (0.125,) * 8}
    assert distribution.join(known, found)["steady"].text() == "~0.12 [0.12, 2.00]"


def test_a_file_of_distributions(tmp_path: Path) -> None:
    found, _ = run(tmp_path)
    path = tmp_path / "kept.json"
    distribution.write_distributions(path, found)
    assert distribution.read_distributions(path) == found
    again = distribution.join(found, run(tmp_path, seed=2)[0])
    assert set(again["chaotic"].seeds) == {"1", "2"}
    assert again["chaotic"].overlap()
    # the longer list of one seed is kept, with its failures
    short = Distribution(30.0, {"1": (31.0,)}, {"1": 1})
    long = Distribution(30.0, {"1": (31.0, 32.0), "2": (3.0,)}, {"1": 2, "nominal": 1})
    for old, new in ((short, long), (long, short)):
        joined = distribution.join({"a": old}, {"a": new})["a"]
        assert (joined.seeds, joined.failed["1"]) == (long.seeds, 2)
    # runs of another code version are not joined
    other = Distribution(30.0, {"2": (31.0, 32.0)})
    assert distribution.join(again, {"chaotic": other})["chaotic"] == other
    for text in ("", "[]", "{}", '{"cells": 1}', '{"cells": {"a": {"1": [1]}}}',
                 '{"cells": {"a": {"nominal": 1, "1": ["x"]}}}'):  # fmt: skip
        path.write_text(text)
        with refused("kept.json"):
            distribution.read_distributions(path)


def test_labels_make_a_table() -> None:
    cells = {"finger/a/θ = 0π": Distribution(1.0), "finger/b/θ = 0π": Distribution(3.0),
             "finger/a/θ = 1π": Distribution(3.0, {"1": (5.0,)})}  # fmt: skip
    assert distribution.pivot(cells, ["robot", "change"], "mean").splitlines() == [
        "| robot | change | θ = 0π | θ = 1π | mean |",
        "| --- | --- | --- | --- | --- |",
        "| finger | a | 1.00 | ~4.00 [3.00, 5.00] | ~2.50 ± 1.50 [2.00, 3.00] |",
        "| finger | b | 3.00 | - | 3.00 ± 0.00 |",
    ]


def test_what_a_distribution_holds() -> None:
    cell = Distribution(1.0, {"1": (2.0, 3.0, 4.0), "2": (2.5, 9.0, 4.0)})
    assert cell.holds(9.0)
    assert cell.holds(0.9996)  # prints as 1.00
    assert not cell.holds(0.9)
    assert not cell.holds(math.inf)
    assert cell.overlap()
    assert not Distribution(1.0, {"1": (2.0, 3.0, 4.0), "2": (4.5, 9.0, 5.0)}).overlap()
    assert Distribution(1.0, {"1": (2.0, 4.0), "2": (4.5, 9.0, 5.0)}).overlap()  # too few
    assert Distribution(math.inf).text() == "none"


def test_means_are_taken_run_by_run() -> None:
    cells = [Distribution(1.0, {"1": (2.0, 4.0)}), Distribution(3.0)]
    mean, std = distribution.mean_and_std(cells)
    assert mean == Distribution(2.0, {"1": (2.5, 3.5)})
    assert std == Distribution(1.0, {"1": (0.5, 0.5)})
    assert mean.text(std) == "~2.50 ± 0.50 [2.00, 3.50]"
    assert distribution.mean_and_std([*cells, Distribution(math.inf)])[0].text() == "none"
    uneven = [Distribution(1.0, {"1": (2.0, 4.0, 8.0)}), Distribution(3.0, {"1": (4.0,)})]
    assert distribution.mean_and_std(uneven)[0] == Distribution(2.0, {"1": (3.0,)})


def test_the_table_is_marked() -> None:
    kept = {benchmark.label(CHAOTIC): Distribution(3.0, {"1": (4.0, 5.0)}),
            benchmark.label(STEADY): Distribution(0.125)}  # fmt: skip
    runs = [(STEADY, {"final_error_cm": 0.5}), (CHAOTIC, {"mse_cm2": None})]
    found = benchmark.distributions(runs, kept)
    assert found["outside"] == ["θ = 0.5π", "ω = 0.5π"]
    assert set(found["ensemble"]) == {"trajectories_cm2", "tt_mean_cm2"}
    row = {
        "robot": "finger", "controller": "ic", "paper": None, "failed": [], "not_solved": 0,
        "sp_mean_cm": 0.5, "sp_std_cm": 0.0, "tt_mean_cm2": None, "tt_std_cm2": None,
        "set_points_cm": {"0.5": 0.5}, "trajectories_cm2": {"0.5": None}, "fallbacks": 0,
        "max_bound_violation": 0.0, **found,
    }  # fmt: skip
    text = benchmark_document([row])
    assert "| 0.50 ± 0.00 | - | - | ~4.00 ± 0.00 [3.00, 5.00] | - | - |" in text
    assert "| 0.50 | ~4.00 [3.00, 5.00] | 0 |" in text
    assert "- finger, IC: θ = 0.5π, ω = 0.5π" in text
    assert benchmark.distributions(runs, {}) == {"ensemble": {}, "outside": []}


def test_seeds_of_one_distribution_are_told_from_seeds_of_two() -> None:
    random = np.random.default_rng(0)

    def cells(shift: float) -> dict[str, Distribution]:
        draws = random.normal(size=(60, 13)) + shift * (np.arange(13) < 8)
        return {str(k): Distribution(x[0], {"1": (*x[:8],), "2": (*x[8:],)})
                for k, x in enumerate(draws)}  # fmt: skip

    same, other = (Agreement.of(cells(shift)) for shift in (0.0, 1.5))
    assert (len(same.cells), same.allowed) == (60, 7)
    assert len(same.apart) <= same.allowed < len(other.apart)
    # 2 of the 1287 ways to choose 5 of 13 are as extreme as two disjoint groups
    assert Distribution(1.0, {"1": tuple(range(8)), "2": tuple(range(8, 13))}).chance() == (
        pytest.approx(2 / 1287)
    )
    assert Distribution(1.0, {"1": (1.0, 1.0), "2": (1.0, 1.0)}).chance() == 1.0


def test_two_seeds_of_the_committed_ensembles_agree() -> None:
    found = Agreement.of(benchmark.committed())
    assert found.disjoint == ()
    assert len(found.apart) <= found.allowed
    # cells that vary with one seed run equally often with the other
    runs = [len(x) for cell in found.cells.values() for x in cell.seeds.values()]
    assert len(found.cells) >= 90
    assert min(runs) >= 5
