"""Imported by the server from which solves are forked (sweeps.isolate): each finds the kernels of the solver loaded.

One thread, whatever the user has set: what a solve costs is told as of one thread, and a server that had several could
not fork without some of its children hanging. The server ends with the process that began it, and its solves with it.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

# only now: libraries read their number of threads when they load
from gelforge.flow.step import die_with_parent
from gelforge.sweeps.methods import warm_up

die_with_parent()
warm_up()
