"""Imported by the server from which solves are forked (sweeps.isolate): each finds the kernels of the solver loaded.

The server ends with the process that began it, and its solves with it.
"""

import os

from gelforge.flow.orphans import die_with_parent
from gelforge.sweeps.isolate import ASKED_BY

die_with_parent()
if os.environ.get(ASKED_BY) not in (None, str(os.getppid())):  # it has died before
    raise SystemExit

# only now: to load them takes a second, in which the other may die
from gelforge.sweeps.methods import warm_up  # noqa: E402

warm_up()
