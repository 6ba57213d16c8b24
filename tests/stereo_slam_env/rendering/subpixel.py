"""A sub-pixel matcher without the bias that it is to measure: Gauss-Newton on whole surfaces, smoothed beforehand."""

import cv2
import numpy as np

_SMOOTHING = 1.5  # px: band-limited pictures can be interpolated between pixels almost without error
_BORDER = 8


def disparity_bias(left, right, disparity):
    """How much larger the disparity in the pictures is than `disparity` (H, W), px, on average over its finite part."""
    smooth_left, smooth_right = (
        cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), _SMOOTHING)
        for image in (left, right)
    )
    gradient = cv2.Sobel(smooth_right, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    rows, columns = np.indices(disparity.shape, dtype=np.float32)
    usable = cv2.erode(np.isfinite(disparity).astype(np.uint8), np.ones((2 * _BORDER + 1,) * 2), borderValue=0) > 0
    known = np.where(usable, disparity, 0.0)
    usable &= (columns - known > _BORDER) & (columns - known < columns.shape[1] - _BORDER)
    assert usable.mean() > 0.2
    bias = 0.0
    for _ in range(8):
        at = (columns - known - bias).astype(np.float32)
        seen = cv2.remap(smooth_right, at, rows, cv2.INTER_LANCZOS4)
        slope = cv2.remap(gradient, at, rows, cv2.INTER_LANCZOS4)
        bias -= float((slope * (smooth_left - seen))[usable].sum() / (slope**2)[usable].sum())
    return bias
