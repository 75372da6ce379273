"""Expects an error whose message is one sentence that holds certain words."""

import contextlib
from collections.abc import Iterable, Iterator

import pytest

from gsut import InputError


@contextlib.contextmanager
def raises_saying(words: Iterable[str]) -> Iterator[None]:
    with pytest.raises(InputError) as caught:
        yield
    message = str(caught.value)
    assert [word for word in words if word not in message] == [], message
    assert "\n" not in message and len(message) < 700
