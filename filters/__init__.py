"""Stereo EKF-SLAM filters behind one interface. Estimation only: numpy and scipy.

`__init__.pyi` lists the public names. A name is imported when it is first used: scipy alone takes longer than most
programs want to wait for `--help`.
"""

from filters.contract.extras import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
