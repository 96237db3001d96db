"""The out-of-focus environment behind a subject, free of noise and aliasing."""

from __future__ import annotations

import numpy as np

from assets_procedural.conventions.panorama import direction_to_uv, pad_sphere, rotate_z, shrink


def backdrop(
    panorama: np.ndarray, rays: np.ndarray, rotation: float, blur_radius_px: float
) -> np.ndarray:
    """What a camera sees of the environment, blurred as by a thin lens with a round aperture.

    `panorama` (H, 2H, 3); `rays` (h, w, 3) world directions through the pixel centres of a pinhole
    camera, of any length; `rotation` of the environment, radians; `blur_radius_px` radius of the
    circle of confusion of infinity, pixels (`blur_radius`). Returns (h, w, 3) float32, linear.

    A panorama has far fewer texels than a portrait lens resolves, so it is read through a cubic
    B-spline, which is smooth and never negative; where it is finer than the picture it is
    averaged first. The picture is computed with a margin, so that light from outside the frame
    blurs into it.
    """
    if rays.ndim != 3 or rays.shape[2] != 3:
        raise ValueError(f"rays must be (h, w, 3), not {rays.shape}")
    if not blur_radius_px >= 0.0:
        raise ValueError(f"blur_radius_px must be >= 0, not {blur_radius_px}")
    height, width = rays.shape[:2]
    margin = int(np.ceil(blur_radius_px)) + 2
    wide = _extrapolate(rays, margin)
    sharp = _spline_lookup(panorama, rotate_z(wide, -rotation))
    if blur_radius_px > 0.25:
        sharp = _convolve(sharp, _disc(blur_radius_px))
    return sharp[margin : margin + height, margin : margin + width].astype(np.float32)


def blur_radius(
    focal_mm: float, f_number: float, subject_distance: float, sensor_mm: float, width_px: int
) -> float:
    """Radius in pixels of the circle of confusion of infinity.

    The lens is focused at `subject_distance` metres; `sensor_mm` is the sensor's width, which
    `width_px` pixels cover.
    """
    focus_mm = subject_distance * 1000.0
    if focus_mm <= focal_mm:
        raise ValueError(f"the subject at {focus_mm:g} mm is nearer than the focal length")
    diameter_mm = focal_mm**2 / (f_number * (focus_mm - focal_mm))
    return 0.5 * diameter_mm / sensor_mm * width_px


def _extrapolate(rays: np.ndarray, margin: int) -> np.ndarray:
    """Rays of the same pinhole camera for `margin` more pixels on each side.

    A pinhole's rays are M (column, row, 1) up to their lengths: four corners determine M.
    """
    height, width = rays.shape[:2]
    if min(height, width) < 2:
        raise ValueError(f"at least 2 x 2 rays are needed, not {rays.shape}")
    rows = []
    for row, column in ((0, 0), (0, width - 1), (height - 1, 0), (height - 1, width - 1)):
        pixel = np.array([column / width, row / height, 1.0])
        x, y, z = rays[row, column] / np.linalg.norm(rays[row, column])
        # ray x (M pixel) = 0
        for cross in ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)):
            rows.append(np.concatenate([c * pixel for c in cross]))
    matrix = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    middle = matrix @ np.array([0.5, 0.5, 1.0])
    if middle @ rays[height // 2, width // 2] < 0.0:
        matrix = -matrix
    column, row = np.meshgrid(
        np.arange(-margin, width + margin) / width, np.arange(-margin, height + margin) / height
    )
    return np.stack([column, row, np.ones_like(row)], axis=-1) @ matrix.T


def _spline_lookup(panorama: np.ndarray, direction: np.ndarray) -> np.ndarray:
    from scipy import ndimage  # here: slow to import

    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    step = np.median(np.linalg.norm(np.diff(unit, axis=1), axis=-1))
    texel = np.pi / panorama.shape[0]
    factor = 1
    while 2 * factor * texel <= step and panorama.shape[0] % (2 * factor) == 0:
        factor *= 2
    panorama = shrink(panorama, factor)
    height, width = panorama.shape[:2]
    margin = 2
    padded = pad_sphere(panorama, margin)
    uv = direction_to_uv(unit)
    where = np.stack([uv[..., 1] * height - 0.5 + margin, uv[..., 0] * width - 0.5 + margin])
    # prefilter=False: the B-spline smooths instead of interpolating, so it cannot ring.
    channels = [
        ndimage.map_coordinates(padded[..., c], where, order=3, prefilter=False, mode="nearest")
        for c in range(3)
    ]
    return np.stack(channels, axis=-1)


def _disc(radius: float) -> np.ndarray:
    """Kernel of a filled circle with antialiased rim and sum 1."""
    reach = int(np.ceil(radius)) + 1
    offset = np.arange(-reach, reach + 1)
    distance = np.hypot(offset[:, None], offset[None])
    disc = np.clip(radius + 0.5 - distance, 0.0, 1.0)
    return disc / disc.sum()


def _convolve(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Same-size convolution, borders repeated."""
    from scipy import fft

    reach = kernel.shape[0] // 2
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    shape = [fft.next_fast_len(n, real=True) for n in padded.shape[:2]]
    kernel_spectrum = np.asarray(fft.rfft2(kernel, s=shape))[..., None]
    spectrum = np.asarray(fft.rfft2(padded, s=shape, axes=(0, 1))) * kernel_spectrum
    blurred = np.asarray(fft.irfft2(spectrum, s=shape, axes=(0, 1)))
    start = 2 * reach
    # The transform leaves rounding noise below zero next to very bright lights.
    return np.maximum(blurred[start : start + image.shape[0], start : start + image.shape[1]], 0.0)
