"""How what cannot be used is refused: gelforge.errors.BadInput, in one printable sentence."""

import re
from collections.abc import Callable

import pytest

from gelforge.errors import BadInput


def refused(said: str, call: Callable, *args, **words) -> str:
    """The sentence in which a call refuses; `said`, a regular expression, is what it must name."""
    with pytest.raises(BadInput) as error:
        call(*args, **words)
    sentence = str(error.value)
    assert re.search(said, sentence), f"{said!r} is not in {sentence!r}"
    assert sentence.isprintable(), sentence
    return sentence
