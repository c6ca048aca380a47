"""Presses that show one picture: a camera that froze, or a path that was copied from row to row."""

from collections.abc import Hashable, Sequence

from gelforge.records.press import PressRecord, RawRow

MOST_NAMED = 5  # pictures in one message, and presses of one picture


def repeats(records: Sequence[PressRecord | RawRow], pictures: Sequence[Hashable]) -> list[list[int]]:
    """Numbers of the records that show one picture under different presses, for each such picture.

    pictures: what stands for the content of each record's picture; None where it shows none. Frames of one press may show
    one picture, as where a log runs faster than its camera.
    """
    found: dict[Hashable, list[int]] = {}
    for at, picture in enumerate(pictures):
        if picture is not None:
            found.setdefault(picture, []).append(at)
    several = (members for members in found.values() if len(members) > 1)
    return [members for members in several if len({records[at].press_id or at for at in members}) > 1]


def describe_repeats(where: str, records: Sequence[PressRecord], found: Sequence[Sequence[int]]) -> str:
    """One sentence about `repeats`; where: the file that the presses are of."""
    each = []
    for members in found[:MOST_NAMED]:
        names = [f"{records[at].sample_id} ({records[at].image})" for at in members]
        more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        each.append(", ".join(names[:MOST_NAMED]) + more)
    more = f"; {len(found) - MOST_NAMED} more such pictures" if len(found) > MOST_NAMED else ""
    count = sum(map(len, found))
    return (
        f"{where}: {count} presses share {len(found)} picture{'s' if len(found) > 1 else ''} of the same content:"
        f" {'; '.join(each)}{more}"
    )
