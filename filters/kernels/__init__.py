"""The EKF in machine code: the whole frame of a filter in one call, for one filter or for many at once (Numba).

`recipe` says in plain numbers what a filter does, `storage` keeps the state of many filters in arrays, the kernels
(`covariance`, `prediction`, `projection`, `gating`, `correction`, `retraction`, `landmarks`) are tested against a
textbook filter, `frame` puts them in order, and `filters.engine.engine` is what is called from Python.

Only the upper triangle of the row-major P is read, which is the lower one of BLAS. Loops are written out because Numba
compiles them in a fraction of the time it takes for assignments of slices.
"""

from filters.contract.extras import require_core

require_core("numba")
