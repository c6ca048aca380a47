"""How long the load steps of a leg are: halved where no equilibrium is found, doubled again after easy ones."""

from collections.abc import Callable

from gelforge.mechanics.result import NoEquilibrium

REST = 0.3  # of a step: a shorter rest of the leg is taken along with it


class StepControl:
    """Load steps of a path's legs. most_cuts: how often a step may be halved. easy: most Newton iterations of an easy one."""

    def __init__(self, most_cuts: int, easy: int = -1) -> None:
        self.most_cuts, self.easy = most_cuts, easy
        self.cuts = 0

    def follow(self, start: float, stop: float, largest: float, advance: Callable[[float, float], int]) -> None:
        """Go from path parameter `start` to exactly `stop` in steps of `largest` at most.

        advance: takes one step to a path parameter, with the share of pending contact changes to carry out, and returns its
        Newton iterations; raises NoEquilibrium, changing nothing. That of the shortest step passes through.
        """
        at, step, pending = start, largest, largest
        while stop - at > 1e-9:
            ahead = min(step, stop - at)
            last = stop - at - ahead < REST * ahead
            if last:
                ahead = stop - at
            aim = stop if last else at + ahead  # exactly the stop: states are looked up by it
            try:
                used = advance(aim, min(1.0, ahead / pending))
            except NoEquilibrium:
                self.cuts += 1
                pending, step = max(pending, ahead), 0.5 * ahead
                if step < largest / 2**self.most_cuts:
                    raise
                continue
            at, pending = aim, step
            if used <= self.easy:
                step = min(2.0 * step, largest)
