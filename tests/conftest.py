"""Settings that hold for all tests."""

import os

# The tests run in several processes, so linear algebra gets one thread in each. The variables are
# read when numpy and scipy are imported, which is after this file.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
