"""Square patches of an image: cut at sub-pixel positions, and warped to how they should look from another place.

Integer (u, v) is the centre of a pixel. Patches are (N, size, size) float32 grey values, rows first.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters import StereoCamera
from filters.contract.validation import finite_array
from filters.geometry.arrays import FloatArray
from filters.kernels.compilation import entry, kernel

Image = NDArray[np.uint8]
Patches = NDArray[np.float32]

PATCH = 11
"""Side of the patch that is compared (the paper's), px."""
SUPPORT = 25
"""Side of the patch that is stored: what a warp reaches for lies beyond the 11 x 11, px."""
FLAT = 1.0
"""Standard deviation below which a patch is noise, not texture: it correlates with nothing, grey levels."""

_SHRINKS = 1.15
"""From this scale on a warp averages, so that fine texture does not alias."""
_MOST_BLUR = 1.5
"""Largest difference of the blur of two patches that is made up for, px^2: more would make noise of the texture."""
_SINGULAR = 1e-12
"""Least squared determinant of a warp that is divided by."""


def cut_patches(image: Image, centers: ArrayLike, size: int = SUPPORT) -> Patches:
    """Patches (N, size, size) centred on sub-pixel positions (N, 2), px, by Catmull-Rom interpolation; `size` is odd.

    Pixels beyond the border repeat those on it. A `ValueError` where `centers` is not (N, 2) or not finite.
    """
    return _cut_all(np.ascontiguousarray(image), finite_array("centers", centers, ("N", 2)), size)


@entry
def _cut_all(image: Image, centers: FloatArray, size: int) -> Patches:
    patches = np.empty((len(centers), size, size), dtype=np.float32)
    for k in range(len(centers)):
        cut(image, centers[k, 0], centers[k, 1], patches[k])
    return patches


@kernel
def cut(image: Image, u: float, v: float, patch: Patches | FloatArray) -> None:
    """Fill a square patch with the pixels around (u, v), as of `cut_patches`; for compiled code.

    All pixels of a patch share the fraction of its centre, so the interpolation is one weighted sum of four rows and
    one of four columns. `cv2.remap` rounds positions to 1/32 px (OpenCV 4), and its INTER_CUBIC does not reproduce a
    ramp: displaced.
    """
    (height, width), size = image.shape, len(patch)
    u0, v0 = math.floor(u), math.floor(v)
    along_u, along_v, row = np.empty(4), np.empty(4), np.empty(size + 3)
    _weigh(u - u0, along_u)
    _weigh(v - v0, along_v)
    for y in range(size):
        for x in range(size + 3):
            column = min(max(u0 - size // 2 - 1 + x, 0), width - 1)
            row[x] = 0.0
            for i in range(4):
                row[x] += along_v[i] * image[min(max(v0 - size // 2 - 1 + y + i, 0), height - 1), column]
        for x in range(size):
            patch[y, x] = (
                along_u[0] * row[x] + along_u[1] * row[x + 1] + along_u[2] * row[x + 2] + along_u[3] * row[x + 3]
            )


@kernel
def _weigh(f: float, weights: FloatArray) -> None:
    """Catmull-Rom weights of the four neighbours at -1, 0, 1, 2 for a fraction in [0, 1)."""
    weights[0] = ((1.0 - 0.5 * f) * f - 0.5) * f
    weights[1] = (1.5 * f - 2.5) * f * f + 1.0
    weights[2] = ((2.0 - 1.5 * f) * f + 0.5) * f
    weights[3] = (0.5 * f - 0.5) * f * f


def warped_patches(patches: Patches, affine: ArrayLike, size: int = PATCH, image_blur: float = 0.0) -> Patches:
    """Stored patches (N, s, s) as they should look now, (N, size, size); `affine` (N, 2, 2) is of `local_affine`.

    By Catmull-Rom interpolation, as the patches of the present image are cut: the sharper of two patches would match
    displaced. Where the patch shrinks (one step in the current image spans more than 1.15 px of the stored one), every
    value is the average of 2 x 2 samples a half step apart: enough against aliasing up to twice the size. Samples
    beyond the stored patch repeat its border. `image_blur` is that of `TrackerSettings`, px^2.
    """
    A = finite_array("affine", affine, ("N", 2, 2))
    if len(A) != len(patches):
        raise ValueError(f"affine must have one matrix per patch: {len(patches)} patches, {len(A)} matrices")
    if not image_blur:
        return _interpolated(patches, A, size)
    return _sharpened(_interpolated(patches, A, size + 2), _blur_gained(A, image_blur))


def _interpolated(patches: Patches, affine: FloatArray, size: int) -> Patches:
    """The patches as the plane through them would look now."""
    squares = np.einsum("nij,nij->n", affine, affine)
    determinant = affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0]
    longest_squared = 0.5 * (squares + np.sqrt(np.maximum(squares**2 - 4.0 * determinant**2, 0.0)))
    shrinks = longest_squared > _SHRINKS**2
    interpolated = _sampled(patches, affine, size, 1.0)
    if shrinks.any():
        fine = _sampled(patches[shrinks], affine[shrinks], 2 * size, 0.5)
        interpolated[shrinks] = fine.reshape(-1, size, 2, size, 2).mean(axis=(2, 4))
    return interpolated


@entry
def _sampled(patches: Patches, affine: FloatArray, size: int, step: float) -> Patches:
    """`size` x `size` samples of each patch, `step` px apart in the current image and centred."""
    side = patches.shape[1]
    sampled = np.empty((len(patches), size, size), dtype=np.float32)
    along_u, along_v = np.empty(4), np.empty(4)
    for k in range(len(patches)):
        for y in range(size):
            dv = step * (y - 0.5 * (size - 1))
            for x in range(size):
                du = step * (x - 0.5 * (size - 1))
                u = min(max(affine[k, 0, 0] * du + affine[k, 0, 1] * dv + side // 2, 1.0), side - 2.0)
                v = min(max(affine[k, 1, 0] * du + affine[k, 1, 1] * dv + side // 2, 1.0), side - 2.0)
                u0, v0 = min(int(u), side - 3), min(int(v), side - 3)
                _weigh(u - u0, along_u)
                _weigh(v - v0, along_v)
                value = 0.0
                for i in range(4):
                    row = 0.0
                    for j in range(4):
                        row += along_u[j] * patches[k, v0 - 1 + i, u0 - 1 + j]
                    value += along_v[i] * row
                sampled[k, y, x] = value
    return sampled


def _blur_gained(affine: FloatArray, image_blur: float) -> FloatArray:
    """Blur of warped patches beyond that of the current image, covariance (N, 2, 2) px^2; negative where it is less.

    Every picture has the blur of the camera or the renderer, I `image_blur`; a warp by A makes it A^-1 A^-T as large.
    """
    (a, b), (c, d) = affine.transpose(1, 2, 0)
    squared_determinant = np.maximum((a * d - b * c) ** 2, _SINGULAR)
    inverse = np.stack([b * b + d * d, -a * b - c * d, -a * b - c * d, a * a + c * c], axis=-1).reshape(-1, 2, 2)
    gained = image_blur * (inverse / squared_determinant[:, None, None] - np.eye(2))
    clipped: FloatArray = np.clip(gained, -_MOST_BLUR, _MOST_BLUR)
    return clipped


def _sharpened(patches: Patches, gained: FloatArray) -> Patches:
    """Patches (N, s + 2, s + 2) less the blur (N, 2, 2) that they have `gained`, px^2: (N, s, s).

    A blur of covariance C adds tr(C H) / 2 to a value, with H the second derivatives. They are taken along the rows,
    then along the columns: so the product of the two, of fourth order, is right as well.
    """
    uu, uv, vv = (gained[:, i, j].astype(np.float32)[:, None, None] for i, j in ((0, 0), (0, 1), (1, 1)))
    by_rows = (1.0 + uu) * patches[:, :, 1:-1]
    by_rows -= 0.5 * uu * (patches[:, :, 2:] + patches[:, :, :-2])
    sharper: Patches = (1.0 + vv) * by_rows[:, 1:-1]
    sharper -= 0.5 * vv * (by_rows[:, 2:] + by_rows[:, :-2])
    twisted = patches[:, 2:, 2:] + patches[:, :-2, :-2]
    twisted -= patches[:, 2:, :-2]
    twisted -= patches[:, :-2, 2:]
    sharper -= 0.25 * uv * twisted
    return sharper


def local_affine(camera: StereoCamera, uvd_then: ArrayLike, R: ArrayLike, t: ArrayLike) -> FloatArray:
    """Change of the appearance of landmarks' surroundings: offset in the image now -> offset then, (N, 2, 2) px.

    `uvd_then` (N, 3) px is the landmark in the view of the patch, and p_now = R p_then + t, one pose or one for each.
    The surroundings are taken for a plane through the landmark, parallel to the image in which the patch was cut. Such
    a plane n . p = z with n = (0, 0, 1) induces the homography R + t n^T / z of the rays; this is the inverse of its
    derivative at the landmark, in pixels. 1/z = d / (f b), so a landmark at infinity (d = 0) is nothing special. Not
    finite where the plane is seen edge-on, without meaning where the landmark is behind the camera.
    """
    uvd = np.asarray(uvd_then, dtype=np.float64)
    R_now_then = np.broadcast_to(np.asarray(R, dtype=np.float64), (len(uvd), 3, 3))
    w = uvd[:, 2] / camera.disparity_constant
    h = np.einsum("nij,nj->ni", R_now_then, camera.ray(uvd)) + w[:, None] * np.asarray(t, dtype=np.float64)
    to_pixel = camera.project_jacobian(h)[:, :2]
    by_pixel = R_now_then[:, :, :2] / (camera.fx, camera.fy)  # t n^T / z acts on the third component only
    forward = to_pixel @ by_pixel
    (a, b), (c, d) = forward.transpose(1, 2, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse: FloatArray = np.stack([d, -b, -c, a], axis=-1).reshape(-1, 2, 2) / (a * d - b * c)[:, None, None]
    return inverse


def parallax(camera: StereoCamera, uvd_then: ArrayLike, R: ArrayLike, t: ArrayLike) -> FloatArray:
    """Derivative of (u, v) by the logarithm of 1/z: how far depth has moved landmarks between two views; (N, 2) px.

    Arguments as of `local_affine`; without meaning where the landmark is behind the camera.
    """
    uvd = np.asarray(uvd_then, dtype=np.float64)
    shift = uvd[:, 2:] / camera.disparity_constant * np.asarray(t, dtype=np.float64)
    h = np.einsum("nij,nj->ni", np.broadcast_to(np.asarray(R, dtype=np.float64), (len(uvd), 3, 3)), camera.ray(uvd))
    moved: FloatArray = np.einsum("nij,nj->ni", camera.project_jacobian(h + shift)[:, :2], shift)
    return moved
