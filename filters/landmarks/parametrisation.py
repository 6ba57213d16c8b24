"""Interface of landmark parametrisations.

Every landmark is one block of three parameters in the state, plus, where it is anchored, one block for the
anchor position. All functions take many landmarks at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from filters.camera import StereoCamera
from filters.validation import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class NewLandmarks:
    """Parameters of M new landmarks (Eq. 19) and their Jacobians (Eq. 25).

    Attributes
    ----------
    parameters : (M, 3)
        Without the anchor, which is the camera position itself.
    by_position, by_rotation : (M, 3, 3)
        With respect to r^WC and to the rotation error (camera frame): J_xc of Eq. 25.
    by_measurement : (M, 3, 3)
        With respect to (u, v, d): J_R of Eq. 25.
    anchored : (M,) bool
        Whether the landmark has an anchor.
    """

    parameters: FloatArray
    by_position: FloatArray
    by_rotation: FloatArray
    by_measurement: FloatArray
    anchored: BoolArray


@dataclass(frozen=True, eq=False)
class ScaledPoints:
    """M landmarks relative to the camera centre, in homogeneous form: point - r^WC = direction / scale.

    Attributes
    ----------
    homogeneous : (M, 4)
        Direction in W (3), and scale.
    by_position : (M, 4, 3)
        Jacobian by the camera position.
    by_map : (M, 4, w)
        Jacobian by the landmark's own numbers: anchor (where the model has anchors), then parameters.
    """

    homogeneous: FloatArray
    by_position: FloatArray
    by_map: FloatArray


@dataclass(frozen=True, eq=False)
class Points:
    """M landmark positions (M, 3) in W, m, and their Jacobian (M, 3, w) by anchor (if any) and parameters."""

    positions: FloatArray
    by_map: FloatArray


@dataclass(frozen=True, eq=False)
class InverseDistances:
    """Inverse distances (M,), 1/m, and their Jacobians by the camera position and by the parameters (M, 3)."""

    values: FloatArray
    by_position: FloatArray
    by_parameters: FloatArray


@runtime_checkable
class LandmarkModel(Protocol):
    """Parametrisation of landmarks: initialisation, position relative to a camera, and their Jacobians.

    Everywhere below, `parameters` are (M, 3) and `anchors` (M, 3), or None where the model has none; a row of NaN
    stands for a landmark without one. The camera is one for all landmarks, `position` (3,) and `R_wc` (3, 3), or one
    for each, (M, 3) and (M, 3, 3).

    References
    ----------
    Civera, Davison and Montiel, "Inverse depth parametrization for monocular SLAM", IEEE TRO 24(5), 2008.
    Sola, Vidal-Calleja, Civera and Montiel, "Impact of landmark parametrization on monocular EKF-SLAM with points and
    lines", IJCV 97(3), 2012.
    Huang, Mourikis and Roumeliotis, "Observability-based rules for designing consistent EKF SLAM estimators", IJRR
    29(5), 2010 (`first_estimates`).
    """

    @property
    def anchored(self) -> bool:
        """Whether landmarks have an anchor block in the state (with `Hybrid` some have none)."""

    @property
    def shares_anchors(self) -> bool:
        """Whether landmarks that enter the map in one frame share one anchor block."""

    def can_initialise(self, camera: StereoCamera, R_wc: FloatArray, uvd: FloatArray) -> BoolArray:
        """Which of the measurements (M, 3) this parametrisation can start a landmark from."""

    def initialise(self, camera: StereoCamera, position: FloatArray, R_wc: FloatArray, uvd: FloatArray) -> NewLandmarks:
        """Start landmarks from measurements (M, 3) seen from the pose (Eq. 19-25)."""

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Landmarks as seen from the camera position: direction in W, and scale; (M, 4)."""

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""

    def points(self, anchors: FloatArray | None, parameters: FloatArray) -> Points:
        """Landmark positions in W."""

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """d parameters / d (rotation vector of the world about its origin); (M, 3) -> (M, 3, 3)."""

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """Parameters of the landmarks turned with the world, as the right-invariant retraction wants it.

        Parameters
        ----------
        anchors, parameters : (M, 3)
            Before.
        turn, spread : (3, 3)
            Exp(theta), and the left Jacobian of theta.
        correction : (M, 3)
            The rest of the correction, to first order added after the turn.
        """

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """Parameters at which first-estimates Jacobians are taken; (M, 3), (M, 3) -> (M, 3)."""

    def inverse_distances(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray
    ) -> InverseDistances:
        """Inverse distances from the anchor, or from the camera position where there is no anchor."""
