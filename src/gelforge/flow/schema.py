"""Parameter tables as dataclasses, and how pydantic checks a TOML table against such a class.

A field's type says what kind of value it takes, and which values are allowed:

    class SolverTable(ParameterTable):
        steps: Annotated[int, Within(1, 1000)]
        size: Annotated[Number, Within(0.01, 10.0, "mm")]
        law: Literal["no_slip", "coulomb"]

A field with a default may be left out. Stage parameters have none here: theirs stand in workflow/params.toml alone.
Only `parse` imports pydantic: stages read what the plan has checked, and start faster without it.
"""

import copy
import json
import types
from collections.abc import Callable, Iterator
from dataclasses import MISSING, dataclass, fields
from functools import lru_cache
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from annotated_types import Ge, GroupedMetadata, Le, MinLen, Predicate

from gelforge.errors import BadInput, nearest

Number = int | float  # not float alone: keys of solves differ between 2 and 2.0, so a value is kept as it was given


@dataclass(frozen=True)
class Within(GroupedMetadata):
    """Numbers from `low` to `high`, both included, with their unit."""

    low: float
    high: float
    unit: str = ""

    def __iter__(self) -> Iterator[Any]:
        """Yield the constraints that pydantic checks."""
        yield Ge(self.low)
        yield Le(self.high)


@dataclass(frozen=True)
class Rule(Predicate):
    """Values for which `func` is true. said: the rule in words."""

    said: str


def rises(numbers: tuple[float, ...]) -> bool:
    """Whether each number is above the one before it."""
    return all(low < high for low, high in zip(numbers, numbers[1:]))


RISING = Rule(rises, "rising")
N = TypeVar("N")
# Limits between which values are drawn uniformly.
Span = Annotated[tuple[N, N], Rule(lambda span: span[0] <= span[1], "the lower one first")]
SOME = MinLen(1)  # of a list: not empty
NAME = r"[A-Za-z0-9_][A-Za-z0-9_.-]*"  # without characters that make or a shell interprets


@dataclass_transform(frozen_default=True)
@dataclass(frozen=True)
class ParameterTable:
    """A parameter table: a class that derives from it becomes a frozen dataclass whose fields are the table's keys.

    example: a file that has all keys.
    """

    example: ClassVar[str] = "workflow/params.toml"
    __pydantic_config__: ClassVar[Any] = {"strict": True, "extra": "forbid", "allow_inf_nan": False}

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True)(cls)

    def __post_init__(self) -> None:
        """Refuse values that are allowed one by one but contradict each other; ValueError with `fault`'s text."""
        if fault := self.fault():
            raise ValueError(fault)

    def fault(self) -> str | None:
        """What is wrong with the combination of values, as a sentence about keys; None if nothing is."""
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
        """This place in words if it is a table."""
        return f"{self.file}: [{'.'.join(self.keys)}]" if self.keys else self.file


def is_table(kind: Any) -> bool:
    """Whether a kind is a parameter table."""
    return isinstance(kind, type) and issubclass(kind, ParameterTable)


@lru_cache(None)
def kinds_of(table: Any) -> dict[str, Any]:
    """Kind of each key of a table, with its annotations. table: a dataclass."""
    hints = get_type_hints(table, include_extras=True)
    return {field.name: hints[field.name] for field in fields(table)}


@lru_cache(None)
def _validate(kind: Any) -> Callable[[str], Any]:
    from pydantic import TypeAdapter

    return TypeAdapter(kind).validate_json


def parse(kind: type[T], given: Any, place: Place) -> T:
    """Read a table; unknown or missing keys and wrong values raise BadInput, one sentence with place and hint."""
    from pydantic import ValidationError

    # as JSON, where pydantic takes a list for a tuple; types that JSON lacks, such as a date, are allowed for no key
    text = json.dumps(given, default=lambda _: float("nan"))
    table: Any = kind
    try:
        return _validate(table)(text)
    except ValidationError as error:
        errors = error.errors(include_url=False)
    wrong = next((each for each in errors if each["type"] == "unexpected_keyword_argument"), errors[0])
    raise BadInput(_refusal(kind, given, place, wrong))


def _refusal(kind: Any, given: Any, place: Place, wrong: Any) -> str:
    """What is wrong, in words: pydantic gives the place, and the annotations of that place give what is allowed."""
    at: Any = kind
    for step in wrong["loc"]:
        inner = split(at)[0]
        if is_table(inner):
            if wrong["type"] == "unexpected_keyword_argument" and step not in (known := kinds_of(inner)):
                return f"{place.table} {step}: unknown key{nearest(step, known)}"
            if step not in given:
                return f"{place.key(step)} is missing; write it as in {inner.example}"
            at = kinds_of(inner)[step]
        elif get_origin(inner) is dict:
            names, at = get_args(inner)
            if wrong["loc"][-1] == "[key]" and step == wrong["loc"][-2]:
                return f"{place.table} {step}: unknown name{nearest(step, get_args(names))}"
        elif get_origin(inner) is tuple and isinstance(given, list) and is_table(get_args(inner)[0]):
            # TOML tables [[kind]] are read into a list `kinds`
            at, given = get_args(inner)[0], given[step]
            place = Place(place.file, (*place.keys[:-1], f"{place.keys[-1].removesuffix('s')} {step + 1}"))
            continue
        else:
            break
        given, place = given[step], place.key(step)
    if wrong["type"] == "value_error":
        return f"{place.table} {wrong['ctx']['error']}"
    return f"{place} = {given!r}: give {allowed(at)}"


def split(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type without the None of an optional key, and its annotations."""
    if get_origin(hint) is Annotated:
        hint, *own = get_args(hint)
        kind, more = split(hint)
        return kind, (*own, *more)
    if get_origin(hint) in (Union, types.UnionType) and type(None) in get_args(hint):
        return split(Union[tuple(each for each in get_args(hint) if each is not type(None))])  # noqa: UP007
    return hint, ()


def allowed(hint: Any) -> str:
    """What a value may be, in words."""
    kind, rules = split(hint)
    said = next((rule.said for rule in rules if isinstance(rule, Rule)), "")
    if kind in (int, Number):
        name = "a whole number" if kind is int else "a number"
        bounds = next((rule for rule in rules if isinstance(rule, Within)), None)
        return f"{name} from {bounds.low:g} to {bounds.high:g} {bounds.unit}".rstrip() if bounds else name
    if get_origin(kind) in (Union, types.UnionType):
        return " or ".join(allowed(each) for each in get_args(kind) if each is not type(None))
    if get_origin(kind) is Literal:
        *words, last = (f'"{word}"' for word in get_args(kind))
        return f"{', '.join(words)} or {last}" if words else last
    if get_origin(kind) is tuple:
        inner = get_args(kind)
        least = next((rule.min_length for rule in rules if isinstance(rule, MinLen)), 0)
        count = f"{least} or more" if inner[-1] is Ellipsis else len(inner)
        return f"a list of {count}, each {allowed(inner[0])}{f', {said}' if said else ''}"
    if get_origin(kind) is dict:
        return f"a table, each value {allowed(get_args(kind)[1])}"
    if is_table(kind):
        return f"a table, with the keys {', '.join(kinds_of(kind))}"
    return said or {bool: "true or false", str: "text"}.get(kind, "another value")


def structured(kind: Any, given: Any) -> Any:
    """The inverse of `plain` for a value that was checked: lists become tuples, and tables dataclasses.

    A table may lack keys: it then has no attribute of that name, unless the key has a default.
    """
    kind = split(kind)[0]
    if is_table(kind):
        made, known = object.__new__(kind), kinds_of(kind)
        values = {field.name: field.default for field in fields(kind) if field.default is not MISSING}
        for name, value in (values | {name: structured(known[name], value) for name, value in given.items()}).items():
            object.__setattr__(made, name, value)
        return made
    if isinstance(given, list):
        return tuple(structured(get_args(kind)[0], value) for value in given)
    if get_origin(kind) is dict:
        return {name: structured(get_args(kind)[1], value) for name, value in given.items()}
    return given


def altered(table: T, **values: Any) -> T:
    """A copy of a table, which may lack keys, with other values of some keys."""
    made = copy.copy(table)
    for name, value in values.items():
        object.__setattr__(made, name, value)
    return made


def plain(value: Any) -> Any:
    """A table as values of TOML and JSON: dictionaries and lists, without keys that are None or missing."""
    if isinstance(value, ParameterTable):
        found = ((field.name, getattr(value, field.name, None)) for field in fields(value))
        return {name: plain(each) for name, each in found if each is not None}
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value
