"""Programs that print a table, write JSON and compare with a committed baseline.

Times are those of one core. Linear algebra reads how many it may use when NumPy is first imported, hence here.
"""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
