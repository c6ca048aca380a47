"""What a table of parameters may hold, said by a dataclass, and how a table of TOML or JSON is read by it.

A field's type says what kind of value it takes, and its annotation which values have a meaning:

    @dataclass(frozen=True)
    class SolverTable(ParameterTable):
        steps: Annotated[int, Within(1, 1000)]
        size: Annotated[float, Within(0.01, 10.0, "mm")]
        law: Annotated[str, OneOf("no_slip", "coulomb")]

Kinds: bool, int, float (whole numbers pass as they are), str, tuples of these, dictionaries of them by name, other
tables, and any of them `| None` for a key that may be left out, as may one whose field has a default. Parameters of the
stages have none: theirs stand in workflow/params.toml alone.
"""

import re
import sys
import types
from collections.abc import Iterable
from dataclasses import MISSING, Field, dataclass, fields
from difflib import get_close_matches
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin, get_type_hints

from gelforge.errors import BadInput

LARGEST = sys.float_info.max  # TOML has whole numbers of any length, and words for what is not finite


@dataclass(frozen=True)
class Within:
    """Numbers from `low` to `high`, both allowed, with their unit. On a list: each of its numbers."""

    low: float
    high: float
    unit: str = ""


@dataclass(frozen=True)
class Named:
    """A name that make and a shell take as it stands. On a list: each of its words. empty: "" is one, too."""

    empty: bool = False

    def holds(self, text: str) -> bool:
        """Whether a text is such a name."""
        return (self.empty and not text) or re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]*", text) is not None


@dataclass(frozen=True)
class OneLine:
    """Text without line breaks and other characters that cannot be seen."""


class OneOf:
    """One of a few words. On a list or a dictionary: each of its words or keys."""

    def __init__(self, *words: str):
        self.words = words


@dataclass(frozen=True)
class Rising:
    """A list whose numbers rise, and how many of them there must be at least."""

    least: int = 1


@dataclass(frozen=True)
class Some:
    """A list that is not empty."""


@dataclass(frozen=True)
class ParameterTable:
    """A table of parameters: a frozen dataclass whose fields are its keys. example: a file that has all of them."""

    example: ClassVar[str] = "workflow/params.toml"

    def fault(self) -> str | None:
        """What is wrong with values that are sound one by one, as a sentence about keys; None where nothing is."""
        return None


T = TypeVar("T", bound=ParameterTable)


@dataclass(frozen=True)
class Place:
    """Where a value stands: the file, and the keys from the outermost table inwards."""

    file: str
    keys: tuple[str, ...] = ()

    def key(self, name: str) -> "Place":
        """The place of a key of this table."""
        return Place(self.file, (*self.keys, name))

    def __str__(self) -> str:
        if len(self.keys) < 2:
            return ": ".join((self.file, *self.keys))
        return f"{self.file}: [{'.'.join(self.keys[:-1])}] {self.keys[-1]}"

    @property
    def table(self) -> str:
        """The same where it is a table."""
        return f"{self.file}: [{'.'.join(self.keys)}]" if self.keys else self.file


def refuse(value: Any, place: Place, allowed: str) -> BadInput:
    """The error for a value that has no meaning: table, key, what was given, what is allowed, and the file."""
    return BadInput(f"{place} = {value!r}: give {allowed}")


def nearest(key: str, known: Iterable[str]) -> str:
    """The end of a sentence that refuses a name: the known one nearest to it, and all of them."""
    known = sorted(known)
    close = get_close_matches(key, known, 1)
    return f"; {f'{close[0]} is meant? ' if close else ''}known here: {', '.join(known)}"


def kinds_of(table: Any) -> dict[str, Any]:
    """Kind of each key of a table, which is a dataclass, with its annotations."""
    hints = get_type_hints(table, include_extras=True)
    return {field.name: hints[field.name] for field in fields(table)}


def parse(kind: type[T], given: Any, place: Place, **made: Any) -> T:
    """Read a table; unknown, missing or meaningless keys raise BadInput, one sentence with place, value and remedy.

    made: values of fields that are no keys of the table.
    """
    known = {name: hint for name, hint in kinds_of(kind).items() if name not in made}
    if not isinstance(given, dict):
        raise refuse(given, place, f"a table, with the keys {', '.join(known)}")
    for key in given:
        if key not in known:
            raise BadInput(f"{place.table} {key}: is read by nothing{nearest(key, known)}")
    absent = {
        field.name: left_out(kind, field, place) for field in fields(kind) if field.name in known.keys() - given
    }
    values = {key: read_value(known[key], value, place.key(key)) for key, value in given.items()}
    table = kind(**made, **absent, **values)
    fault = table.fault()
    if fault:
        raise BadInput(f"{place.table} {fault}")
    return table


def left_out(kind: type[ParameterTable], field: Field, place: Place) -> Any:
    """The value of a key that a table does not have: its default, None where it may be, else it is refused."""
    if field.default is not MISSING:
        return field.default
    if type(None) in get_args(bare(kinds_of(kind)[field.name])):
        return None
    raise BadInput(f"{place.key(field.name)} is missing; write it as in {kind.example}")


def bare(hint: Any) -> Any:
    """A kind without its annotations."""
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def read_value(hint: Any, given: Any, place: Place, rules: tuple[Any, ...] = ()) -> Any:
    """A value of TOML or JSON by its kind: numbers and words as they are, lists as tuples, tables as dataclasses."""
    if get_origin(hint) is Annotated:
        hint, *more = get_args(hint)
        rules = (*rules, *more)
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return read_either([kind for kind in inner if kind is not type(None)], given, place, rules)
    if origin is tuple:
        return read_list(inner, given, place, rules)
    if origin is dict:
        return read_names(inner[1], given, place, rules)
    if isinstance(hint, type) and issubclass(hint, ParameterTable):
        return parse(hint, given, place)
    return read_one(hint, given, place, rules)


def read_either(kinds: list[Any], given: Any, place: Place, rules: tuple[Any, ...]) -> Any:
    """A value that may be of several kinds."""
    for kind in kinds:
        try:
            return read_value(kind, given, place, rules)
        except BadInput:
            continue
    raise refuse(given, place, " or ".join(allowed_values(bare(kind), (*rules, *rules_of(kind))) for kind in kinds))


def rules_of(hint: Any) -> tuple[Any, ...]:
    """The annotations of a kind."""
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


def read_one(kind: type, given: Any, place: Place, rules: tuple[Any, ...]) -> Any:
    """A number, a word or a truth value."""
    fits = {
        bool: isinstance(given, bool),
        int: isinstance(given, int) and not isinstance(given, bool),
        float: isinstance(given, int | float) and not isinstance(given, bool) and abs(given) <= LARGEST,
        str: isinstance(given, str),
    }[kind]
    for rule in rules:
        if fits and isinstance(rule, Within) and kind in (int, float):
            fits = rule.low <= given <= rule.high
        if fits and isinstance(rule, OneOf) and kind is str:
            fits = given in rule.words
        if fits and isinstance(rule, OneLine):
            fits = given.isprintable()
        if fits and isinstance(rule, Named):
            fits = rule.holds(given)
    if not fits:
        raise refuse(given, place, allowed_values(kind, rules))
    return given


def allowed_values(kind: Any, rules: tuple[Any, ...]) -> str:
    """What a value may be, in words."""
    bounds = next((rule for rule in rules if isinstance(rule, Within)), None)
    words = next((rule.words for rule in rules if isinstance(rule, OneOf)), ())
    if kind in (int, float):
        name = "a whole number" if kind is int else "a number"
        span = f" from {bounds.low:g} to {bounds.high:g}" if bounds else ""
        return f"{name}{span}{f' {bounds.unit}' if bounds and bounds.unit else ''}"
    if kind is str and words:
        return " or ".join(filter(None, [", ".join(f'"{word}"' for word in words[:-1]), f'"{words[-1]}"']))
    if kind is str and any(isinstance(rule, Named) for rule in rules):
        return "a name of letters, digits, dots, - and _"
    return {
        bool: "true or false",
        str: "text of one line" if any(isinstance(rule, OneLine) for rule in rules) else "text",
    }.get(kind, "another value")


def read_list(inner: tuple[Any, ...], given: Any, place: Place, rules: tuple[Any, ...]) -> tuple[Any, ...]:
    """A list: of any length where its kind ends in …, else of exactly so many."""
    any_length = inner[-1] is Ellipsis
    each = allowed_values(bare(inner[0]), (*rules_of(inner[0]), *rules))
    rising = next((rule for rule in rules if isinstance(rule, Rising)), None)
    least = rising.least if rising else 1 if any(isinstance(rule, Some) for rule in rules) else 0
    count = f"{least} or more" if any_length else str(len(inner))
    allowed = f"a list of {count}, each {each}{', rising' if rising else ''}"
    if not isinstance(given, list | tuple) or (len(given) < least if any_length else len(given) != len(inner)):
        raise refuse(given, place, allowed)
    try:
        found = tuple(read_value(inner[0], value, place, rules) for value in given)
    except BadInput as error:
        raise refuse(given, place, allowed) from error
    if rising and any(low >= high for low, high in zip(found, found[1:])):
        raise refuse(given, place, allowed)
    return found


def read_names(kind: Any, given: Any, place: Place, rules: tuple[Any, ...]) -> dict[str, Any]:
    """A table whose keys are names that people choose."""
    if not isinstance(given, dict):
        raise refuse(given, place, "a table")
    words = next((rule.words for rule in rules if isinstance(rule, OneOf)), None)
    for key in given:
        if words and key not in words:
            raise BadInput(f"{place.table} {key}: is no name here{nearest(key, words)}")
    return {key: read_value(kind, value, place.key(key)) for key, value in given.items()}


def plain(value: Any) -> Any:
    """A table as TOML and JSON have it: dictionaries, lists, and no keys that were left out."""
    if isinstance(value, ParameterTable):
        found = ((field.name, getattr(value, field.name)) for field in fields(value))
        return {name: plain(each) for name, each in found if each is not None}
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value
