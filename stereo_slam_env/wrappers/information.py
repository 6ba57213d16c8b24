r"""How much is left unknown: potentials over the joint covariance of pose and map; their decrease is information gain.

Every landmark has a prior of its own from the beginning, $N(\text{anything}, \sigma^2 I)$ with $\sigma$ the prior
sigma; what the filter knows of it is fused with that. A landmark that was never seen, was dropped, or has no finite
position stands at the prior. So all maps have the same landmarks, seen or not, and their potentials can be compared:
potentials are relative to a map of which nothing is known, in which the number of unseen landmarks cancels.

P is the covariance of the pose (position in W, m; rotation, rad) and of N landmarks, $P_{mm}$ its map block.

`log-det`, `entropy`
    $\Phi = \ln\det(P^{-1} + D)^{-1} - 3N\ln\sigma^2$ with $D = \mathrm{diag}(0_6, \sigma^{-2} I_{3N})$, which is
    $\ln\det P - \ln\det(\sigma^2 I + P_{mm})$. Differences are in nats (entropy: half of them) and do not depend on
    units.
`a-optimality`, `d-optimality`, `e-optimality`
    A variance v(B) of each 3 x 3 block B: the mean of its eigenvalues, their geometric mean $\det(B)^{1/3}$, or the
    largest. $\Phi = v(P_{rr}) + \sigma^2 v(P_{\theta\theta}) + \sum_i [v(B_i) - \sigma^2]$, m^2, with
    $B_i = (P_{ii}^{-1} + \sigma^{-2} I)^{-1}$. Sums over blocks, not one matrix of all: their scale does not change
    as the map grows. A rotation counts by what it moves at the distance $\sigma$.

Each Phi only falls when P falls or a landmark enters. In the linear Gaussian case a measurement of known or new
landmarks never raises it; motion (process noise), and landmarks that leave, do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from filters.motion import POSE_SIZE, POSITION, ROTATION
from filters.validation import BoolArray, FloatArray, positive

CRITERIA = ("log-det", "entropy", "d-optimality", "a-optimality", "e-optimality")
SUBJECTS = ("map", "pose")
FARTHEST = 1e4
"""Prior sigmas: a landmark with a larger standard deviation stands at the prior. Its depth is as good as unknown; so
far away (kilometres) its direction, fused with the prior, says nothing either, and rounding would."""


@dataclass(frozen=True)
class InformationCriterion:
    """A potential of the joint covariance of pose and map; see the module for the formulas.

    Parameters
    ----------
    name : str
        One of `CRITERIA`.
    of : {"map", "pose"}
        Of pose and map together, or of the pose alone (its marginal).
    prior_sigma : float
        Standard deviation of each coordinate of an unseen landmark, m, and the lever of the rotation.

    Raises
    ------
    ValueError
        A name is unknown, or the prior is not positive.
    """

    name: str = "log-det"
    of: str = "map"
    prior_sigma: float = 10.0

    def __post_init__(self) -> None:
        for name, value, known in (("criterion", self.name, CRITERIA), ("of", self.of, SUBJECTS)):
            if value not in known:
                raise ValueError(f"{name} must be one of {', '.join(map(repr, known))}, got {value!r}")
        positive("prior_sigma", self.prior_sigma)

    def potential(self, joint: FloatArray) -> float:
        """What is left unknown; nats, or m^2.

        Parameters
        ----------
        joint : (6 + 3 N, 6 + 3 N) ndarray
            As of `StereoFilter.joint_covariance`; rows of landmarks need not be finite.

        Raises
        ------
        ArithmeticError
            The covariance is not positive definite, so the filter has broken down.
        """
        P = joint[:POSE_SIZE, :POSE_SIZE] if self.of == "pose" else without_the_unknown(joint, self.prior_sigma)
        if self.name == "log-det":
            return log_det_potential(P, self.prior_sigma)
        if self.name == "entropy":
            return 0.5 * log_det_potential(P, self.prior_sigma)
        return block_potential(P, self.prior_sigma, self.name)


def log_det_potential(P: FloatArray, prior_sigma: float) -> float:
    """The potential `log-det`, nats; P (6 + 3 N, 6 + 3 N) finite."""
    P_mm = P[POSE_SIZE:, POSE_SIZE:].copy()
    P_mm.flat[:: len(P_mm) + 1] += prior_sigma**2
    return log_det(P) - log_det(P_mm)


def block_potential(P: FloatArray, prior_sigma: float, name: str) -> float:
    """The potential `a-optimality`, `d-optimality` or `e-optimality`, m^2; P (6 + 3 N, 6 + 3 N) finite."""
    unknown = prior_sigma**2
    own = np.stack([P[POSITION, POSITION], unknown * P[ROTATION, ROTATION]])
    variances = _variances(own, name).sum()
    eigenvalues = np.maximum(np.linalg.eigvalsh(_landmark_blocks(P)), 0.0)  # tiny ones may come out negative
    fused = eigenvalues * unknown / (eigenvalues + unknown)
    return float(variances + (_of_eigenvalues(fused, name) - unknown).sum())


def log_det(P: FloatArray) -> float:
    """Natural logarithm of the determinant of a symmetric positive definite matrix, by its Cholesky factor.

    The matrix is scaled to unit variances first, so that metres, radians and far landmarks do not drown each other.

    Raises
    ------
    ArithmeticError
        There is no Cholesky factor.
    """
    variances = P.diagonal()
    if not (variances > 0).all():
        raise ArithmeticError(f"a covariance has a variance of {variances.min():.3g}: it must be positive definite")
    scale = 1.0 / np.sqrt(variances)
    factor, info = lapack.dpotrf(np.asfortranarray(P * scale[:, None] * scale), lower=1, clean=0, overwrite_a=1)
    if info != 0:
        raise ArithmeticError("a covariance has no Cholesky factor: it must be positive definite")
    return 2.0 * float(np.log(factor.diagonal()).sum()) + float(np.log(variances).sum())


def without_the_unknown(joint: FloatArray, prior_sigma: float) -> FloatArray:
    """The joint covariance without the landmarks that stand at the prior: not finite, or `FARTHEST` uncertain."""
    known = _are_known(_landmark_blocks(joint), prior_sigma)
    if known.all():
        return joint
    rows = np.concatenate([np.ones(POSE_SIZE, dtype=bool), known.repeat(3)])
    rest: FloatArray = joint[np.ix_(rows, rows)]
    return rest


def _are_known(blocks: FloatArray, prior_sigma: float) -> BoolArray:
    with np.errstate(invalid="ignore"):
        known: BoolArray = np.einsum("nii->n", blocks) <= (FARTHEST * prior_sigma) ** 2
    known &= np.isfinite(blocks).all(axis=(1, 2))
    return known


def _landmark_blocks(joint: FloatArray) -> FloatArray:
    """The covariance of each landmark, (N, 3, 3)."""
    count = (len(joint) - POSE_SIZE) // 3
    by_landmark = joint[POSE_SIZE:, POSE_SIZE:].reshape(count, 3, count, 3)
    index = np.arange(count)
    blocks: FloatArray = by_landmark[index, :, index]
    return blocks


def _variances(blocks: FloatArray, name: str) -> FloatArray:
    return _of_eigenvalues(np.maximum(np.linalg.eigvalsh(blocks), 0.0), name)


def _of_eigenvalues(eigenvalues: FloatArray, name: str) -> FloatArray:
    """The variance v of blocks from their eigenvalues (M, 3), ascending."""
    if name == "a-optimality":
        mean: FloatArray = eigenvalues.mean(axis=-1)
        return mean
    if name == "e-optimality":
        largest: FloatArray = eigenvalues[..., -1]
        return largest
    geometric: FloatArray = np.cbrt(eigenvalues.prod(axis=-1))
    return geometric
