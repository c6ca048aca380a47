"""Checks that unusable input is refused by gelforge.errors.BadInput, in one printable sentence."""

import re
from collections.abc import Callable

import pytest

from gelforge.errors import BadInput


def refused(said: str, call: Callable, *args, **words) -> str:
    """The sentence of the BadInput that a call raises, which must match the regular expression `said`."""
    with pytest.raises(BadInput) as error:
        call(*args, **words)
    sentence = str(error.value)
    assert re.search(said, sentence), f"{said!r} is not in {sentence!r}"
    assert sentence.isprintable(), sentence
    return sentence
