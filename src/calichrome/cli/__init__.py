"""The command line: one file per command; it parses, calls and prints."""

import os

# Our problems are many small dense ones: threads of BLAS cost more than they bring (a solve took
# 0.5 s with one and 2.2 s with two on a busy machine). Set before numpy is loaded; the user's own
# setting wins.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
