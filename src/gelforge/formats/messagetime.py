"""When the messages of a recording happened: by the stamps in their headers, or by the log where these cannot serve.

A message is logged when it arrives, often 0.1 s after it was measured, and later for images than for forces.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

SAME_CLOCK_NS = 10**9  # by how much the delays of two topics may differ before their stamps are of two clocks
LAPSE = 1.5  # of the usual interval: beyond, messages are missing


def stamp_of(said) -> int:
    """Time in the header of a ROS message, or in `timestamp` of Foxglove's schemas, ns; 0 where it has none or an empty one."""
    stamp = getattr(getattr(said, "header", None), "stamp", None) or getattr(said, "timestamp", None)
    for names in (
        ("sec", "nanosec"),
        ("sec", "nsec"),
        ("seconds", "nanos"),
    ):  # ROS, Foxglove in JSON, protobuf's Timestamp
        seconds, rest = (getattr(stamp, name, None) for name in names)
        if isinstance(seconds, int) and isinstance(rest, int):
            return seconds * 10**9 + rest
    return 0


@dataclass(frozen=True)
class MessageTimes:
    """Times of the messages of one topic in the order of the log: logged (n,) and stamped (n,) ns, 0 for no stamp."""

    topic: str
    logged: np.ndarray
    stamped: np.ndarray

    @classmethod
    def of(cls, topic: str, times: Iterable[tuple[int, int]]) -> "MessageTimes":
        """From (log time, stamp) of each message, ns."""
        both = np.array(list(times), np.int64).reshape(-1, 2)
        return cls(topic, both[:, 0], both[:, 1])

    @property
    def delay(self) -> int:
        """Median time from stamp to log, ns, of the messages that have a stamp."""
        has = self.stamped != 0
        return int(np.median(self.logged[has] - self.stamped[has]))

    @property
    def fault(self) -> str:
        """Why the stamps say nothing; empty where they do."""
        stamps = self.stamped[self.stamped != 0]
        if not len(stamps):
            return f"messages of {self.topic} have no time in their headers"
        if len(stamps) > 1 and stamps.min() == stamps.max():
            return f"all messages of {self.topic} have the same time in their headers"
        return ""


@dataclass(frozen=True)
class PairingClock:
    """Which time pairs two topics: that of the headers, or else that of the log; notes: what to report of it."""

    header: bool
    notes: list[str]


def choose_clock(one: MessageTimes, other: MessageTimes) -> PairingClock:
    """The clock that both topics of a recording share."""
    if not len(one.logged) or not len(other.logged):
        return PairingClock(False, [])
    faults = [times.fault for times in (one, other) if times.fault]
    if not faults and abs(one.delay - other.delay) > SAME_CLOCK_NS:
        faults = [
            f"the headers of {one.topic} and {other.topic} are of different clocks, {1e-9 * one.delay:.3f} and"
            f" {1e-9 * other.delay:.3f} s before the log's"
        ]
    if not faults:
        return PairingClock(True, [])
    note = f"{' and '.join(faults)}, so the log's time was used: forces may be of another moment than their images"
    return PairingClock(False, [note])


@dataclass(frozen=True)
class MessageOrder:
    """Messages of a topic in the order of time, each once: index (n,) in the log, times (n,) ns; notes: what was found."""

    index: np.ndarray
    times: np.ndarray
    notes: list[str]

    @classmethod
    def by(cls, messages: MessageTimes, header: bool) -> "MessageOrder":
        """The order by header or log; a message that repeats a stamp is left out, and so is one without a stamp."""
        index = np.flatnonzero(messages.stamped) if header else np.arange(len(messages.logged))
        times = (messages.stamped if header else messages.logged)[index]
        late = int((np.diff(times) < 0).sum())
        order = np.argsort(times, kind="stable")
        index, times = index[order], times[order]
        # messages that arrive in one burst may share the log's time
        first = np.concatenate([[True], np.diff(times) > 0]) if header and len(times) else np.ones(len(times), bool)
        counts = {
            "without a time in the header are left out": len(messages.logged) - len(index),
            "repeat the time of another one and are left out": int((~first).sum()),
            "came out of order and are sorted": late,
            "seem to be missing": _missing(times[first]),
        }
        notes = [f"{messages.topic}: {count} messages {what}" for what, count in counts.items() if count]
        return cls(index[first], times[first], notes)


def _missing(times: np.ndarray) -> int:
    """How many messages are missing between times (n,), by their usual interval."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual <= 0:
        return 0
    return int((np.rint(steps[steps > LAPSE * usual] / usual) - 1).sum())
