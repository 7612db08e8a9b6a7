"""A real browser for tests; without one they are skipped, but fail in CI."""

from __future__ import annotations

import os
import warnings

import pytest

from tests.proof.film.chromium import CHROMIUM, Browser

__all__ = ["Browser", "required"]


def required() -> pytest.MarkDecorator:
    """Skip without a browser; in CI its absence is a failure."""
    if CHROMIUM is None and os.environ.get("CI"):
        raise RuntimeError("CI needs Chromium: apt-get install chromium")
    reason = "NO CHROMIUM: THE VIEWER IS NOT TESTED (apt-get install chromium)"
    if CHROMIUM is None:
        # printed, because a skip is only one letter in a long row
        warnings.warn(reason, stacklevel=2)
    return pytest.mark.skipif(CHROMIUM is None, reason=reason)
