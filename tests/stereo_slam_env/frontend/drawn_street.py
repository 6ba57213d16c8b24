"""A street of textured boards, drawn by homographies: both views, exact truth, a few milliseconds a pair."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from filters import Pose, Start
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from stereo_slam_env.recording.recording import SIMULATION, StereoPair

CAMERA = StereoCamera(300.0, 300.0, 239.5, 119.5, 0.6, 480, 240)
DT = 0.1


@dataclass(frozen=True)
class Board:
    """A textured rectangle in W: `corner`, and two edges in m; it moves by `velocity`, m/s."""

    corner: tuple
    along: tuple
    down: tuple
    texel: float
    velocity: tuple = (0.0, 0.0, 0.0)

    @property
    def size(self):
        return [round(float(np.linalg.norm(edge)) / self.texel) for edge in (self.along, self.down)]

    def frame(self, time):
        """Columns: metres in W per texel along and down, and the centre of the first texel."""
        width, height = self.size
        axes = np.array([self.along, self.down]).T / [width, height]
        origin = np.array(self.corner) + time * np.array(self.velocity) + 0.5 * axes.sum(axis=1)
        return np.column_stack([axes, origin])

    def painted(self, rng):
        width, height = self.size
        grey = np.zeros((height, width))
        for sigma in (1.2, 3.0, 10.0):
            layer = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), sigma)
            grey += layer / layer.std()
        return np.clip(128 + 30 * grey, 5, 250).astype(np.float32)


STREET = (
    Board((-40, -20, 30), (80, 0, 0), (0, 40, 0), 0.1),
    Board((-6, -4, 30), (0, 0, -22), (0, 6, 0), 0.04),
    Board((1.0, -3, 14), (5, 0, 1.5), (0, 5, 0), 0.045),
    Board((-3, 0, 9), (1.8, 0, 0), (0, 1.8, 0), 0.03),
)
CAR = Board((-1.2, -1.2, 9), (4.0, 0, 0), (0, 2.6, 0), 0.03, velocity=(2.5, 0.0, 3.0))
"""A bus, rather: 130 x 90 px."""


@dataclass
class DrawnStreet:
    """An `ImageSequence` of a camera that drives by `step` (m, right, down and forward) and `turn` (rad) a pair.

    The right image may be `right_shift` px off: what a rectification leaves.
    """

    count: int = 10
    step: tuple = (0.02, 0.0, 0.3)
    turn: tuple = (0.0, 0.004, 0.0)
    boards: tuple = STREET
    right_shift: float = 0.0
    noise: float = 1.0
    seed: int = 0

    name = "drawn street"
    camera = CAMERA
    start = Start()
    source = {"drawn": True}  # noqa: RUF012 - as of every sequence: a mapping
    skipped = {}  # noqa: RUF012
    truth_from = SIMULATION

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self._textures = [board.painted(rng) for board in self.boards]

    def __len__(self):
        return self.count

    def pairs(self):
        for number in range(self.count):
            yield self.pair(number)

    def pair(self, number):
        """Pair `number`; any number, also beyond `count`."""
        R_wc, position = self.pose(number)
        rng = np.random.default_rng((self.seed, number))
        left, right = (self._drawn(R_wc, position, number, eye, rng) for eye in (0, 1))
        return StereoPair(number * DT, left, right, truth=Pose(position, Rotation.from_matrix(R_wc).as_quat()))

    def pose(self, number):
        R_wc, position = np.eye(3), np.zeros(3)
        for _ in range(number):
            position = position + R_wc @ np.array(self.step)
            R_wc = R_wc @ rotations.exp(np.array(self.turn))
        return R_wc, position

    def _to_pixel(self, board, R_wc, position, number):
        """(3, 3): homogeneous texels -> homogeneous left pixels, scaled by the depth."""
        K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1]])
        frame = board.frame(number * DT)
        frame[:, 2] -= position
        return K @ R_wc.T @ frame

    def _drawn(self, R_wc, position, number, eye, rng):
        eye_position = position + eye * CAMERA.baseline * R_wc[:, 0]
        image, size = np.zeros((CAMERA.height, CAMERA.width), dtype=np.float32), (CAMERA.width, CAMERA.height)
        for board, texture in zip(self.boards, self._textures, strict=True):
            H = self._to_pixel(board, R_wc, eye_position, number)
            H = np.array([[1, 0, eye * self.right_shift], [0, 1, 0], [0, 0, 1]]) @ H
            layer = cv2.warpPerspective(texture, H, size, flags=cv2.INTER_LINEAR, borderValue=-1000.0)
            image = np.where(layer >= 0, layer, image)
        return np.clip(np.rint(image + rng.normal(0, self.noise, image.shape)), 0, 255).astype(np.uint8)

    def points_at(self, number, uv):
        """Points in W (N, 3) seen at left pixels of pair `number`, and the board of each (N,); NaN and -1: none."""
        R_wc, position = self.pose(number)
        homogeneous = np.column_stack([uv, np.ones(len(uv))])
        points, which = np.full((len(uv), 3), np.nan), np.full(len(uv), -1)
        for index, board in enumerate(self.boards):
            texel = np.linalg.solve(self._to_pixel(board, R_wc, position, number), homogeneous.T).T
            s = texel / texel[:, 2:]
            width, height = board.size
            on = (texel[:, 2] > 0) & (s[:, 0] >= 0) & (s[:, 0] < width) & (s[:, 1] >= 0) & (s[:, 1] < height)
            points[on], which[on] = s[on] @ board.frame(number * DT).T, index
        return points, which

    def on_one_board(self, number, uv, reach=7.0):
        """Which pixels have all their surroundings on one board, (N,)."""
        corners = reach * np.array([[0, 0], [-1, -1], [-1, 1], [1, -1], [1, 1]])
        boards = np.stack([self.points_at(number, uv + corner)[1] for corner in corners])
        return (boards == boards[0]).all(axis=0) & (boards[0] >= 0)

    def seen(self, number, points_w):
        """True (u, v, d) of points in pair `number`."""
        R_wc, position = self.pose(number)
        return CAMERA.project((points_w - position) @ R_wc)


class Truth:
    """Where the corners of a run truly are."""

    def __init__(self, street):
        self.street = street
        self.points, self.board, self.clean = {}, {}, {}

    def note(self, number, tracked):
        uv = tracked.corners.uvd[:, :2]
        points, boards = self.street.points_at(number, uv)
        clean = self.street.on_one_board(number, uv)
        for i, point, board, whole in zip(tracked.corners.ids.tolist(), points, boards.tolist(), clean, strict=True):
            self.points[i], self.board[i], self.clean[i] = point, board, bool(whole)

    def errors(self, number, observation):
        """Measured minus true (u, v, d) of the landmarks seen whole, at first and now, (M, 3) px."""
        now = self.street.on_one_board(number, observation.uvd[:, :2])
        whole = [i for i, landmark in enumerate(observation.ids.tolist()) if self.clean[landmark] and now[i]]
        if not whole:
            return np.zeros((0, 3))
        points = np.array([self.points[landmark] for landmark in observation.ids[whole].tolist()])
        return observation.uvd[whole] - self.street.seen(number, points)
