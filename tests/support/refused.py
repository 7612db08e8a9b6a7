"""A block that softdyn refuses: asserted by class, place and value, not by its sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from softdyn.exceptions import InputError, UrdfError, one_line

ANY = object()


@contextmanager
def refused(
    place: str, got: object = ANY, *, by: type[InputError | UrdfError] = InputError
) -> Iterator[pytest.ExceptionInfo]:
    """Expect that the block is refused.

    Parameters
    ----------
    place : str
        The argument, or the element of a URDF. The file or folder before it may be left out.
    got : object
        The value that the error shows, where the place alone does not tell the cause. A text that
        ends with … is its beginning.
    by : type
        `InputError`, a class below it, or `UrdfError`.
    """
    with pytest.raises(by) as caught:
        yield caught
    error = caught.value
    found = error.element if isinstance(error, UrdfError) else error.name
    assert found == place or found.endswith((f": {place}", f"/{place}")), str(error)
    if got is not ANY:
        shown = one_line(got)
        assert error.got == shown or (shown.endswith("…") and error.got.startswith(shown[:-1])), (
            str(error)
        )
