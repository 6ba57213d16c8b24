r"""Potentials of the joint covariance of pose and map; their decrease is the information gain.

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
from typing import Literal, get_args

import numpy as np
from scipy.linalg import lapack

from filters.contract.validation import one_of, positive
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION

Criterion = Literal["log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"]
Subject = Literal["map", "pose"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)
FARTHEST = 1e4
"""Prior sigmas: a landmark with a larger standard deviation stands at the prior. Its depth is as good as unknown; so
far away (kilometres) its direction, fused with the prior, says nothing either, and rounding would."""


@dataclass(frozen=True)
class InformationCriterion:
    """A potential of the joint covariance of pose and map; see the module for the formulas.

    Parameters
    ----------
    name : {"log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"}
        The formula.
    of : {"map", "pose"}
        Of pose and map together, or of the pose alone (its marginal).
    prior_sigma : float
        Standard deviation of each coordinate of an unseen landmark, m, and the lever of the rotation.
    resolution : (2,) sequence of float
        Standard deviations of an error of position, m, and rotation, rad, that is added to the pose: to know it better
        than that is worth next to nothing. With 0 the logarithmic potentials of a pose that is known exactly, as at
        the start, are -infinity in principle, and the first steps lose more than all others.

    Raises
    ------
    ValueError
        A name is unknown, or the prior is not positive.
    """

    name: Criterion = "log-det"
    of: Subject = "map"
    prior_sigma: float = 10.0
    resolution: tuple[float, ...] = (0.0, 0.0)

    def __post_init__(self) -> None:
        one_of("criterion", self.name, CRITERIA)
        one_of("of", self.of, get_args(Subject))
        positive("prior_sigma", self.prior_sigma)
        if len(self.resolution) != 2:
            raise ValueError(f"resolution must be two numbers, of position and rotation, got {self.resolution!r}")
        for sigma in self.resolution:
            positive("resolution", sigma, allow_zero=True)

    def potential(self, joint: FloatArray) -> float:
        """The potential; nats, or m^2.

        Parameters
        ----------
        joint : (6 + 3 N, 6 + 3 N) ndarray
            As of `StereoFilter.joint_covariance`; rows of landmarks need not be finite.

        Raises
        ------
        ArithmeticError
            The covariance is not positive definite, so the filter has broken down.
        """
        P = joint[:POSE_SIZE, :POSE_SIZE] if self.of == "pose" else self._without_unknown(joint)
        if any(self.resolution):
            P = P.copy()
            pose = np.arange(POSE_SIZE)
            P[pose, pose] += np.repeat(self.resolution, 3) ** 2
        unknown = self.prior_sigma**2
        if self.name in ("log-det", "entropy"):
            P_mm = P[POSE_SIZE:, POSE_SIZE:].copy()
            P_mm.flat[:: len(P_mm) + 1] += unknown
            return (0.5 if self.name == "entropy" else 1.0) * (log_det(P) - log_det(P_mm))
        reduction = _eigenvalues(np.stack([P[POSITION, POSITION], unknown * P[ROTATION, ROTATION]]))
        each = _eigenvalues(_landmark_blocks(P))
        fused = each * unknown / (each + unknown)
        return float(self._variances(reduction).sum() + (self._variances(fused) - unknown).sum())

    def pose_potentials(self, covariances: FloatArray) -> FloatArray:
        """The potentials of many poses at once, `of` "pose": from their covariances (B, 6, 6); (B,)."""
        P = covariances + np.diag(np.repeat(self.resolution, 3) ** 2)
        if self.name in ("log-det", "entropy"):
            sign, value = np.linalg.slogdet(P)
            if not (sign > 0).all():
                raise ArithmeticError("a covariance is not positive definite: the filter has broken down")
            return np.asarray((0.5 if self.name == "entropy" else 1.0) * value)
        unknown = self.prior_sigma**2
        position, rotation = P[:, POSITION, POSITION], unknown * P[:, ROTATION, ROTATION]
        return np.asarray(self._variances(_eigenvalues(position)) + self._variances(_eigenvalues(rotation)))

    def _without_unknown(self, joint: FloatArray) -> FloatArray:
        """The joint covariance without the landmarks that stand at the prior: not finite, or `FARTHEST` uncertain."""
        blocks = _landmark_blocks(joint)
        with np.errstate(invalid="ignore"):
            is_known = np.einsum("nii->n", blocks) <= (FARTHEST * self.prior_sigma) ** 2
        is_known &= np.isfinite(blocks).all(axis=(1, 2))
        if is_known.all():
            return joint
        rows = np.concatenate([np.ones(POSE_SIZE, dtype=bool), is_known.repeat(3)])
        rest: FloatArray = joint[np.ix_(rows, rows)]
        return rest

    def _variances(self, eigenvalues: FloatArray) -> FloatArray:
        """The variance v of blocks from their eigenvalues (M, 3), ascending."""
        if self.name == "a-optimality":
            return np.asarray(eigenvalues.mean(axis=-1))
        if self.name == "e-optimality":
            return np.asarray(eigenvalues[..., -1])
        return np.asarray(np.cbrt(eigenvalues.prod(axis=-1)))


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


def _landmark_blocks(joint: FloatArray) -> FloatArray:
    """The covariance of each landmark, (N, 3, 3)."""
    count = (len(joint) - POSE_SIZE) // 3
    by_landmark = joint[POSE_SIZE:, POSE_SIZE:].reshape(count, 3, count, 3)
    index = np.arange(count)
    blocks: FloatArray = by_landmark[index, :, index]
    return blocks


def _eigenvalues(blocks: FloatArray) -> FloatArray:
    """Eigenvalues, ascending; tiny ones may come out negative, and count as 0."""
    return np.asarray(np.maximum(np.linalg.eigvalsh(blocks), 0.0))
