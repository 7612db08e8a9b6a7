"""Every planted defect is named: some comparisons of `python -m tests.proof planted`."""

import pytest

from tests.proof import planted


@pytest.mark.parametrize("seed", [44, 54])  # robots of two joints
def test_planted_defects_are_named(tmp_path, seed):
    found = planted.campaign(6, 1, seed, tmp_path)
    assert [str(trial) for trial in found if trial.called not in ("named", "equivalent")] == []
    small = [p for trial in found for p in trial.plants if p.kind in ("pose", "centre", "turn")]
    assert min(plant.size for plant in small) < 1e-4  # m, rad
    assert sum(bool(trial.causes) for trial in found) == 6
