"""Renderers by name, and camera effects on their pictures: optics, exposure and noise, the same for seed and frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from filters.geometry.camera import StereoCamera
from stereo_slam_env.files.package_versions import version_of
from stereo_slam_env.rendering.gl import GLRenderer
from stereo_slam_env.rendering.pinhole import Image, ImageQuality, StereoImages, StereoRenderer, grey
from stereo_slam_env.rendering.tiny import TinyRenderer
from stereo_slam_env.world.frames import WorldFrame

RendererName = Literal["tiny", "gl"]
RENDERERS: dict[str, str] = {
    "tiny": "PyBullet's own, on the CPU: everywhere, the same bits every time, slow",
    "gl": "OpenGL without a display: fast; needs EGL and the extra gl",
}
"""Names and what they stand for."""


def make_renderer(
    name: str,
    *,
    camera: StereoCamera,
    frame: WorldFrame,
    supersample: int = 1,
    samples: int = 1,
) -> StereoRenderer:
    """A back end that draws both views.

    Parameters
    ----------
    name : str
        One of `RENDERERS`.
    camera : StereoCamera
        The rig.
    frame : WorldFrame
        Where W sits in the scene.
    supersample : int
        Draw this many times finer and average.
    samples : int
        Samples a pixel at the edges of things, only "gl".

    Raises
    ------
    ValueError
        There is no such renderer, or it cannot do what is asked for.
    ImportError, RuntimeError
        PyBullet, or what "gl" needs, is missing; the text says what to install.
    """
    _require_known(name)
    if not isinstance(supersample, int) or supersample < 1:
        raise ValueError(f"supersample must be a whole number from 1, got {supersample!r}")
    if name == "tiny":
        if samples != 1:
            raise ValueError(f'samples must be 1 with renderer "tiny", got {samples!r}: use supersample')
        return TinyRenderer(camera, frame, supersample)
    return GLRenderer(camera, frame, supersample, samples)


def image_quality(name: str, supersample: int = 1) -> ImageQuality:
    """Quality of the images of a back end; a `ValueError` where there is no such renderer."""
    _require_known(name)
    back_end: type[StereoRenderer] = TinyRenderer if name == "tiny" else GLRenderer
    return back_end.image_quality(supersample)


@cache
def renderer_identity(name: str) -> dict[str, str]:
    """`name`, `version` and `device` of what made the pictures: results with different ones are not to be compared.

    Raises as `make_renderer`.
    """
    _require_known(name)
    if name == "tiny":
        return {"name": name, "version": f"PyBullet {version_of('pybullet')}", "device": "CPU"}
    from stereo_slam_env.rendering.gl_resources import device

    return {"name": name, **device()}


def _require_known(name: str) -> None:
    if name not in RENDERERS:
        raise ValueError(f"renderer must be one of {', '.join(RENDERERS)}, got {name!r}")


_RANGES = {
    "gain": (0.75, 1.25),
    "gamma": (0.85, 1.2),
    "read_noise": (0.5, 3.0),
    "shot_noise": (0.0, 0.04),
    "vignetting": (0.0, 0.3),
    "blur": (0.3, 0.9),
}
"""What `CameraEffects.random` draws from."""


@dataclass(frozen=True)
class CameraEffects:
    """Effects of a pair of cameras, in the order of the light: lens (blur, vignetting), exposure, tone curve, noise.

    Noise is the same in all colours of a pixel, as if the camera were a grey one, and independent between pixels,
    cameras and frames. The default is a perfect camera.

    `gain` is the factor on the grey level, `gamma` the exponent of level / 255; `read_noise` is the standard deviation
    that does not depend on the light, `shot_noise` the variance for each grey level of light; `vignetting` is the share
    of the light that is missing in the corners, `blur` the standard deviation of the lens' point spread, px; `seed`
    that of the noise. A `ValueError` where a number is out of its range.
    """

    gain: float = 1.0
    gamma: float = 1.0
    read_noise: float = 0.0
    shot_noise: float = 0.0
    vignetting: float = 0.0
    blur: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, positive in (("gain", True), ("gamma", True), ("read_noise", False), ("shot_noise", False),
                               ("blur", False), ("seed", False)):  # fmt: skip
            value = getattr(self, name)
            if not (np.isfinite(value) and (value > 0 if positive else value >= 0)):
                raise ValueError(f"{name} must be {'> 0' if positive else '>= 0'}, got {value!r}")
        if not 0.0 <= self.vignetting <= 1.0:
            raise ValueError(f"vignetting must be from 0 to 1, got {self.vignetting!r}")

    @classmethod
    def random(cls, rng: np.random.Generator) -> CameraEffects:
        """Any good camera in daylight, for domain randomisation."""
        drawn = {name: float(rng.uniform(*limits)) for name, limits in _RANGES.items()}
        return cls(**drawn, seed=int(rng.integers(2**31)))

    def apply(self, images: StereoImages, frame: int) -> StereoImages:
        """The pair as real cameras would give it; the number of the `frame` and the seed determine the noise."""
        left, right = (self.on(image, frame, side) for side, image in enumerate((images.left, images.right)))
        return replace(images, left=left, right=right)

    def on(self, image: Image, frame: int, side: int) -> Image:
        """One picture, (H, W, 3) or (H, W) uint8, of the left (0) or the right (1) camera."""
        picture = image
        if self.blur > 0:
            picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), self.blur), dtype=np.uint8)
        if self.vignetting > 0:
            lens = _vignetting(image.shape, self.vignetting)
            picture = np.asarray(cv2.multiply(picture, lens, dtype=cv2.CV_8U), dtype=np.uint8)
        if self.gain != 1 or self.gamma != 1:
            picture = np.asarray(cv2.LUT(picture, self._tone_curve), dtype=np.uint8)
        if self.read_noise > 0 or self.shot_noise > 0:
            picture = self._noisy(picture, np.random.SFC64([self.seed, frame, side]))
        return picture.copy() if picture is image else picture

    @cached_property
    def _tone_curve(self) -> Image:
        level = np.clip(self.gain * np.arange(256) / 255.0, 0.0, 1.0)
        return np.asarray(np.rint(255.0 * level**self.gamma), dtype=np.uint8)

    @cached_property
    def _sigmas(self) -> NDArray[np.float32]:
        """Standard deviation of the noise for each grey level; (256,)."""
        return np.asarray(np.sqrt(self.read_noise**2 + self.shot_noise * np.arange(256)), dtype=np.float32)

    def _noisy(self, image: Image, bits: np.random.BitGenerator) -> Image:
        sigma = cv2.LUT(grey(image), self._sigmas)
        normal = _standard_normal(bits, image.shape[:2])
        # What is added and what is taken away, each as bytes: a quarter of the time of signed numbers.
        more, less = (cv2.multiply(sigma, normal, scale=sign, dtype=cv2.CV_8U) for sign in (1.0, -1.0))
        if image.ndim == 3:
            more, less = (cv2.cvtColor(part, cv2.COLOR_GRAY2RGB) for part in (more, less))
        return np.asarray(cv2.subtract(cv2.add(image, more), less), dtype=np.uint8)


def _standard_normal(bits: np.random.BitGenerator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Sums of two numbers of 256 values each: as good as normal for grey levels, a tenth of the time of numpy's."""
    count = int(np.prod(shape))
    raw = np.asarray(bits.random_raw((2 * count + 7) // 8)).astype("<u8", copy=False)
    first, second = raw.view(np.uint8)[: 2 * count].reshape(2, *shape)
    total: NDArray[np.float32] = np.add(cv2.LUT(first, _quantiles()), cv2.LUT(second, _quantiles()))
    return total


@cache
def _quantiles() -> NDArray[np.float32]:
    """Quantiles of a normal distribution, in the middles of 256 equal shares; their variance is one half."""
    quantiles = ndtri((np.arange(256) + 0.5) / 256)
    return np.asarray(quantiles * np.sqrt(0.5 / np.mean(quantiles**2)), dtype=np.float32)


@cache
def _vignetting(shape: tuple[int, ...], strength: float) -> NDArray[np.float32]:
    """Share of the light that arrives, falling with the square of the distance from the middle."""
    y, x = (np.linspace(-1.0, 1.0, size) ** 2 for size in shape[:2])
    share = (1.0 - 0.5 * strength * (y[:, None] + x)).reshape(*shape[:2], *[1] * (len(shape) - 2))
    return np.asarray(np.broadcast_to(share, shape), dtype=np.float32).copy()
