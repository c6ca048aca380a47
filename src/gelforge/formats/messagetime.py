"""Times of the messages of a recording: the stamps in their headers, or log times where stamps are unusable.

A message is logged when it arrives, often 0.1 s after the measurement, and images arrive later than forces.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

SAME_CLOCK_NS = 10**9  # if the delays of two topics differ by more, their stamps come from different clocks
AGREE_NS = 5 * 10**7  # delays of two topics on one clock differ by less, where both seem to be negative
EARLY_NS = 2 * 10**6  # a log time may be so much earlier than its stamp by rounding
LAPSE = 1.5  # median intervals: in a longer gap messages are missing


def stamp_of(said) -> int:
    """Time in the header of a ROS message, or in `timestamp` of Foxglove's schemas, ns; 0 where missing or empty."""
    stamp = getattr(getattr(said, "header", None), "stamp", None) or getattr(said, "timestamp", None)
    # ROS, Foxglove in JSON, protobuf's Timestamp
    for names in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
        seconds, rest = (getattr(stamp, name, None) for name in names)
        if isinstance(seconds, int) and isinstance(rest, int):
            return seconds * 10**9 + rest
    return 0


@dataclass(frozen=True)
class MessageTimes:
    """Times of the messages of one topic in log order: logged (n,) and stamped (n,) ns, 0 for no stamp."""

    topic: str
    logged: np.ndarray
    stamped: np.ndarray

    @classmethod
    def of(cls, topic: str, times: Iterable[tuple[int, int]]) -> "MessageTimes":
        """Make it from (log time, stamp) of each message, ns."""
        both = np.array(list(times), np.int64).reshape(-1, 2)
        return cls(topic, both[:, 0], both[:, 1])

    @property
    def delay(self) -> int:
        """Median of log time minus stamp, ns, over the messages with a stamp."""
        has = self.stamped != 0
        return int(np.median(self.logged[has] - self.stamped[has]))

    @property
    def early(self) -> str:
        """What shows that the stamps are of a clock that is ahead of the recorder's; empty where nothing does."""
        has = self.stamped != 0
        late = self.stamped[has] - self.logged[has]
        if not len(late) or np.median(late) <= EARLY_NS:
            return ""
        return f"the header times of {self.topic} are {1e-9 * float(np.median(late)):.3f} s later than its log times, which is impossible on one clock"

    @property
    def fault(self) -> str:
        """Why the stamps are unusable; empty where they are usable."""
        stamps = self.stamped[self.stamped != 0]
        if not len(stamps):
            return f"messages of {self.topic} have no time in their headers"
        if len(stamps) > 1 and stamps.min() == stamps.max():
            return f"all messages of {self.topic} have the same time in their headers"
        return ""


@dataclass(frozen=True)
class PairingClock:
    """Whether two topics are paired by header times, or else by log times; notes: for the user."""

    header: bool
    notes: list[str]


def choose_clock(one: MessageTimes, other: MessageTimes) -> PairingClock:
    """Choose the clock that both topics of a recording share."""
    if not len(one.logged) or not len(other.logged):
        return PairingClock(False, [])
    faults = [times.fault for times in (one, other) if times.fault]
    if not faults and abs(one.delay - other.delay) > SAME_CLOCK_NS:
        faults = [
            f"the header times of {one.topic} and {other.topic} come from different clocks, {1e-9 * one.delay:.3f} and"
            f" {1e-9 * other.delay:.3f} s before the log's"
        ]
    if not faults:
        faults = [times.early for times in (one, other) if times.early]
        # if both topics are stamped by one clock that is ahead of the recorder's, their stamps still agree
        faults = faults if len(faults) == 1 or abs(one.delay - other.delay) > AGREE_NS else []
    if not faults:
        return PairingClock(True, [])
    return by_log_times(faults)


def by_log_times(faults: list[str]) -> PairingClock:
    """Log times, with a note on why the stamps are not used."""
    note = f"{' and '.join(faults)}, so log times were used: forces may not be simultaneous with their images"
    return PairingClock(False, [note])


@dataclass(frozen=True)
class MessageOrder:
    """Messages of a topic in order of time: index (n,) in the log, times (n,) ns; notes: for the user."""

    index: np.ndarray
    times: np.ndarray
    notes: list[str]

    @classmethod
    def by(cls, messages: MessageTimes, header: bool) -> "MessageOrder":
        """Sort by header or log time; by header, leave out messages without a stamp or with a repeated one."""
        index = np.flatnonzero(messages.stamped) if header else np.arange(len(messages.logged))
        times = (messages.stamped if header else messages.logged)[index]
        late = int((np.diff(times) < 0).sum())
        order = np.argsort(times, kind="stable")
        index, times = index[order], times[order]
        # only stamps: messages that arrive in one burst may share a log time
        first = np.concatenate([[True], np.diff(times) > 0]) if header and len(times) else np.ones(len(times), bool)
        counts = {
            "without a time in the header are left out": len(messages.logged) - len(index),
            "repeat the time of an earlier one and are left out": int((~first).sum()),
            "came out of order and are sorted": late,
            "seem to be missing": _missing(times[first]),
        }
        notes = [f"{messages.topic}: {count} messages {what}" for what, count in counts.items() if count]
        return cls(index[first], times[first], notes)


def _missing(times: np.ndarray) -> int:
    """Number of messages missing between times (n,), by the median interval."""
    steps = np.diff(times)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual <= 0:
        return 0
    return int((np.rint(steps[steps > LAPSE * usual] / usual) - 1).sum())
