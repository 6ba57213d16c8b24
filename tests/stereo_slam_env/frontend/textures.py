"""Images with known values between the pixels: sums of plane waves."""

import numpy as np


class Waves:
    """A random texture, wavelengths evenly spread in the logarithm between two bounds (px)."""

    def __init__(self, seed, shortest=5.0, longest=40.0, count=200):
        rng = np.random.default_rng(seed)
        length = np.exp(rng.uniform(np.log(shortest), np.log(longest), count))
        angle, self.phase = rng.uniform(0, 2 * np.pi, (2, count))
        self.k = 2 * np.pi / length * np.stack([np.cos(angle), np.sin(angle)])
        self.scale = 35.0 / np.sqrt(0.5 * count)

    def values(self, u, v):
        """Grey values (len(v), len(u)) on a grid."""
        columns = np.exp(1j * np.multiply.outer(u, self.k[0]))
        rows = np.exp(1j * (np.multiply.outer(v, self.k[1]) + self.phase))
        return 128.0 + self.scale * (rows @ columns.T).real

    def at(self, points):
        """Grey values (...) at points (..., 2)."""
        return 128.0 + self.scale * np.cos(points @ self.k + self.phase).sum(axis=-1)

    def image(self, width, height, shift=(0.0, 0.0), noise=0.0, rng=None):
        """An image (uint8) of the texture moved by `shift` px, with white noise."""
        values = self.values(np.arange(width) - shift[0], np.arange(height) - shift[1])
        if noise:
            values = values + rng.normal(0.0, noise, values.shape)
        return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def spread_points(rng, count, width, height, margin=30):
    """(count, 2) positions away from the border."""
    return rng.uniform((margin, margin), (width - margin, height - margin), (count, 2))
