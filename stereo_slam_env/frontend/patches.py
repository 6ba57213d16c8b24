"""Square patches of an image: cut at sub-pixel positions, and warped to how they should look from another place.

Integer (u, v) is the centre of a pixel. Patches are (N, size, size) float32 grey values, rows first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from filters import StereoCamera
from filters.contract.validation import finite_array
from filters.geometry.arrays import FloatArray, IntArray

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
_TOGETHER = 60
"""Patches that are warped in one block: what is calculated on the way stays in the processor's cache."""
_MOST_BLUR = 1.5
"""Largest difference of the blur of two patches that is made up for, px^2: more would make noise of the texture."""
_SINGULAR = 1e-12
"""Least squared determinant of a warp that is divided by."""


def cut_patches(image: Image, centers: ArrayLike, size: int = SUPPORT) -> Patches:
    """Patches (N, size, size) centred on sub-pixel positions (N, 2), px, by Catmull-Rom interpolation; `size` is odd.

    Pixels beyond the border repeat those on it. A `ValueError` where `centers` is not (N, 2) or not finite.
    """
    at = finite_array("centers", centers, ("N", 2))
    return np.ascontiguousarray(cut_stack(image, at, size).transpose(2, 0, 1))


def cut_stack(image: Image, centers: FloatArray, size: int) -> Patches:
    """`cut_patches` with the patches along the last axis, (size, size, N): quick to do arithmetic on.

    All pixels of a patch share the fraction of its centre, so the interpolation is one weighted sum of four windows
    along each axis. `cv2.remap` rounds positions to 1/32 px (OpenCV 4), and its INTER_CUBIC does not reproduce a ramp:
    it shifts patches by up to 0.05 px.
    """
    base = np.floor(centers).astype(np.int64)
    windows = windows_at(image, base - (size // 2 + 1), size + 3, size + 3)
    stack = np.ascontiguousarray(windows.transpose(1, 2, 0)).astype(np.float32)
    weights = _catmull_rom((centers - base).T)
    rows = stack[:size] * weights[0, 1]
    for k in (1, 2, 3):
        rows += stack[k : k + size] * weights[k, 1]
    patches: Patches = rows[:, :size] * weights[0, 0]
    for k in (1, 2, 3):
        patches += rows[:, k : k + size] * weights[k, 0]
    return patches


def _catmull_rom(f: FloatArray | Patches) -> Patches:
    """Weights of the four neighbours at -1, 0, 1, 2 for fractions in [0, 1); (...) -> (4, ...)."""
    weights = np.empty((4, *f.shape), dtype=np.float32)
    weights[0] = ((1.0 - 0.5 * f) * f - 0.5) * f
    weights[1] = (1.5 * f - 2.5) * f * f + 1.0
    weights[2] = ((2.0 - 1.5 * f) * f + 0.5) * f
    weights[3] = (0.5 * f - 0.5) * f * f
    return weights


def windows_at(image: Image, origin: IntArray, height: int, width: int) -> Image:
    """Windows (N, height, width) with their first pixel at `origin` (N, 2) (u, v); beyond the border it is repeated."""
    if len(origin) == 0:  # of an image that may be smaller than a window
        return np.zeros((0, height, width), dtype=np.uint8)
    pad_low = max(0, -int(origin.min(initial=0)))
    beyond = origin - (image.shape[1] - width, image.shape[0] - height)
    pad_high = max(0, int(beyond.max(initial=0)))
    if pad_low or pad_high:
        limit = 2 * (height + width)  # further out every window is constant, or nearly so
        pad_low, pad_high = min(pad_low, limit), min(pad_high, limit)
        image = np.pad(image, ((pad_low, pad_high), (pad_low, pad_high)), mode="edge")
        last = (image.shape[1] - width, image.shape[0] - height)
        origin = np.clip(origin + pad_low, 0, last)
    image = np.ascontiguousarray(image)
    starts = (image.shape[0] - height + 1, image.shape[1] - width + 1)
    # As numpy's sliding_window_view, which takes longer than the copy.
    every = np.ndarray((*starts, height, width), image.dtype, image, strides=2 * image.strides)
    windows: Image = every[origin[:, 1], origin[:, 0]]
    return windows


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
    warped = np.empty((len(A), size, size), dtype=np.float32)
    for begin in range(0, len(A), _TOGETHER):
        block = slice(begin, begin + _TOGETHER)
        if image_blur:
            wide = _interpolated(patches[block], A[block], size + 2)
            warped[block] = _sharpened(wide, _blur_gained(A[block], image_blur))
        else:
            warped[block] = _interpolated(patches[block], A[block], size)
    return warped


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


def _sampled(patches: Patches, affine: FloatArray, size: int, step: float) -> Patches:
    """`size` x `size` samples of each patch, `step` px apart in the current image and centred."""
    side = patches.shape[1]
    offsets = step * (np.arange(size) - 0.5 * (size - 1))
    grid = np.stack(np.meshgrid(offsets, offsets)).reshape(2, -1)
    at = np.clip(affine.transpose(1, 0, 2) @ grid + side // 2, 1, side - 2).astype(np.float32)  # u and v: (2, N, K)
    base = np.minimum(np.floor(at), side - 3)
    weights = _catmull_rom(at - base)
    first = (base[1] * side + base[0]).astype(np.intp)
    first += (side * side * np.arange(len(patches)) - side - 1)[:, None]
    sampled = np.zeros(first.shape, dtype=np.float32)
    for i in range(4):
        row = np.zeros_like(sampled)
        for j in range(4):
            row += patches.take(first + (i * side + j)) * weights[j, 0]
        row *= weights[i, 1]
        sampled += row
    return sampled.reshape(-1, size, size)


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
