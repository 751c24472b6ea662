"""Colour methods on measured spectra; benchmarks/README.md says how to run what.

CPU times are those of one thread: the settings below must precede the import of numpy.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
