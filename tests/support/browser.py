"""A real browser for tests: where there is none they are skipped, but in CI."""

from __future__ import annotations

import os
import warnings

import pytest

from tests.proof.film.chromium import CHROMIUM, Browser

__all__ = ["Browser", "required"]


def required() -> pytest.MarkDecorator:
    """Skips where there is no browser, but never in CI: there its absence is a failure."""
    if CHROMIUM is None and os.environ.get("CI"):
        raise RuntimeError("CI needs Chromium: apt-get install chromium")
    reason = "NO CHROMIUM: THE VIEWER IS NOT TESTED (apt-get install chromium)"
    if CHROMIUM is None:
        warnings.warn(reason, stacklevel=2)  # a skip alone is one letter in a long row
    return pytest.mark.skipif(CHROMIUM is None, reason=reason)
