"""Imported by the server from which solves are forked (sweeps.isolate): each finds the kernels of the solver loaded.

One thread, whatever the user has set: what a solve costs is told as of one thread, and a server that had several could
not fork without some of its children hanging.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

from gelforge.sweeps.methods import warm_up

warm_up()
