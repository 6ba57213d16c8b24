"""The EKF in machine code: the whole frame of a filter in one call, for one filter or for many at once (Numba).

`recipe` says in plain numbers what a filter does, `records` keep the state of many filters in arrays, the kernels
(`prediction`, `linearisation`, `gating`, `correction`, `retraction`, `landmarks`) are held against a textbook filter,
`frame` puts them in order, `entries` is what Python calls between frames, and `filters.engine.engine` calls it all.

Only the upper triangle of the row-major P is read, which is the lower one of BLAS. Loops are written out because Numba
compiles them in a fraction of the time it takes for assignments of slices.
"""

from filters.contract.extras import require_core

require_core("numba")
