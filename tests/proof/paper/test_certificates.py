"""The command certify: its table from its own logs, a figure per robot, bad input."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.proof import certify


def test_the_table_and_the_pictures(tmp_path, capsys):
    out = tmp_path / "out"
    asked = ["--robots", "finger", "--thetas", "0.5", "--duration", "0.2", "--json", "-"]
    code = certify.main([*asked, "--out", str(out)])
    rows = {row["controller"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert code == 0
    assert list(rows) == ["soft-id-clf-qp", "id-clf-qp", "clf-qp"]
    assert all(row["samples"] == 40 for row in rows.values())
    # only Soft ID-CLF-QP's accelerations differ from the model's
    assert rows["soft-id-clf-qp"]["above"] > 0.5
    assert rows["id-clf-qp"]["above"] == rows["clf-qp"]["above"] == 0
    assert rows["id-clf-qp"]["weak"] == 0 < rows["id-clf-qp"]["least"]
    assert np.isfinite(rows["clf-qp"]["fastest"])
    assert (out / "certificates_finger.png").read_bytes().startswith(b"\x89PNG")
    assert (out / "certificates.md").read_text().count("\n") == 5


def test_bad_input(capsys):
    with pytest.raises(SystemExit, match="2"):
        certify.main(["--robots", "panda"])
    assert "panda" in capsys.readouterr().err
