"""``python -m hident.pinned ARGUMENTS``: python with these arguments, under hident's arithmetic.

Workers that others start (Dask's, MPI's) load numpy before hident, which then can no longer choose its
kernels; where they are started by this, it has.
"""

from __future__ import annotations

import os
import sys

if __name__ == "__main__":
    # To import the package has set the environment.
    os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
