"""The repository holds no text of other projects, but for the source of the bundled robots."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from pathlib import PurePath

import pytest
from house import ROOT

# The numbers of the bundled robots are the paper's; its files and their licence are kept there.
SOURCE = PurePath("urdf/source")
LONGEST = 2000  # characters of a line that somebody wrote
OURS = "the softdyn developers"
NOTICE = re.compile(
    r"copyright\s*(\(c\)|©|\d{4}).*|©\s*\d{4}.*|\(c\)\s*\d{4}.*|SPDX-License-Identifier.*|@license.*"
    r"|all rights reserved.*|permission is hereby granted.*|redistribution and use in source.*"
    r"|licensed under the .*",
    re.IGNORECASE,
)


def signs(text: str) -> Iterator[str]:
    """What looks as if somebody else had written a text."""
    ours = OURS in text
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > LONGEST:
            yield f"line {number} has {len(line)} characters"
        found = NOTICE.search(line)
        if found and not ours:
            yield f"line {number}: {found[0]}"


def tracked() -> Iterator[tuple[str, str]]:
    """Path and text of each text file that git tracks."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout")
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if path.is_file() and not path.is_symlink() and b"\0" not in (data := path.read_bytes()):
            yield name, data.decode("utf-8", "replace")


def test_no_file_is_somebody_else_s():
    own = ".ci/test_own_text.py", "tests/formats/log_"  # a log has its settings in one line
    files = {name: text for name, text in tracked() if not name.startswith(own)}
    assert len(files) > 500
    found = {name: list(signs(text)) for name, text in files.items()}
    theirs = {name: said for name, said in found.items() if said}
    assert [name for name in theirs if SOURCE in PurePath(name).parents]
    assert {n: said for n, said in theirs.items() if SOURCE not in PurePath(n).parents} == {}


@pytest.mark.parametrize(
    "text",
    [
        "/*! a-library 1.0 | (c) 2020 Somebody */",
        "Copyright (c) 2014-2023, Somebody Else\n",
        "# SPDX-License-Identifier: BSD-3-Clause",
        "Permission is hereby granted, free of charge, to any person",
        " * @license",
        "x = 1\n" + 700 * "a+=b;",
    ],
)
def test_text_of_others_is_recognised(text):
    assert len(list(signs(text))) == 1


def test_own_text_is_not():
    licence = (ROOT / "LICENSE").read_text()
    assert OURS in licence
    assert list(signs(licence)) == []
    assert list(signs("The numbers are those of the paper (MIT license), see urdf/source.")) == []
