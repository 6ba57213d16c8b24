"""Filters head to head, on identical measurements.

>>> from stereo_slam_env.benchmark import compare, run_benchmark
>>> result = run_benchmark("quick", "runs/quick")      # doctest: +SKIP
>>> result.summaries[0].ate_rigid_m                    # doctest: +SKIP
>>> compare("runs/before", "runs/quick").changes       # doctest: +SKIP
"""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
