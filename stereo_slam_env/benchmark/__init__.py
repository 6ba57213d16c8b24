"""Filters head to head, on identical measurements.

>>> from stereo_slam_env.benchmark import compare, run_benchmark
>>> result = run_benchmark("quick", "runs/quick")      # doctest: +SKIP
>>> result.summaries[0].ate_rigid_m                    # doctest: +SKIP
>>> compare("runs/before", "runs/quick").changes       # doctest: +SKIP
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
