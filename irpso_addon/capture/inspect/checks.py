"""Checks of lights and frames for inspect: pure functions of arrays."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from . import three_images

_UNIT = 1e-3  # DiLiGenT's six printed digits stay within 1e-6; a table of three digits within 1e-3
_SAME_LIGHT_DEGREES = 0.01
_MAX_SHIFT = 16  # pixels searched on each side
# A shift counts if the correlation's peak exceeds its value at 0 by _SHIFT_GAIN of the peak, and its median by
# _SHIFT_PEAK deviations; if the residual of a fit by other frames is _BETTER times as large without the shift, and the
# fit correlates by _AGREE with it. Measured on 200 captures without motion (listed in test_capture_inspect.py): the
# largest ratio is 1.31 at correlations from 0.6 on; textured frames that were rolled by 2 to 4 px have 1.5 and more.
_SHIFT_GAIN, _SHIFT_PEAK, _BETTER, _AGREE = 0.05, 5.0, 1.35, 0.6
_PASS = 0.15  # cycles per pixel: width of the low pass that suppresses noise in the correlation


def not_unit(vectors: np.ndarray) -> np.ndarray:
    """Return (K,) bool: directions (K, 3) whose length differs from 1 by more than 0.001."""
    return np.abs(np.linalg.norm(vectors, axis=1) - 1) > _UNIT


def same_lights(directions: np.ndarray) -> list[tuple[int, int]]:
    """Return the pairs of unit directions (K, 3) that are equal within 0.01°."""
    far = np.linalg.norm(directions[:, None] - directions[None], axis=-1)
    i, j = np.nonzero(np.triu(far < np.radians(_SAME_LIGHT_DEGREES), 1))
    return list(zip(i.tolist(), j.tolist(), strict=True))


def similar_frames(frames: np.ndarray, tolerance: float) -> list[tuple[int, int, float]]:
    """Return (i, j, difference) of frames (K, H, W) whose relative RMS difference is at most ``tolerance``."""
    flat = frames.reshape(len(frames), -1).astype(np.float64)
    power = (flat**2).sum(axis=1)
    squares = np.maximum(power[:, None] + power[None] - 2 * flat @ flat.T, 0)
    relative = np.sqrt(squares / np.maximum(np.minimum(power[:, None], power[None]), 1e-30))
    # The difference of squares loses half of the digits, so the few similar pairs are compared exactly.
    near = np.argwhere(np.triu((relative <= tolerance + 1e-5) & (power > 0)[:, None] & (power > 0)[None], 1))
    pairs = []
    for i, j in near.tolist():
        exact = float(np.sqrt(((flat[i] - flat[j]) ** 2).sum() / min(power[i], power[j])))
        if exact <= tolerance:
            pairs.append((i, j, exact))
    return pairs


def middle_window(mask: np.ndarray, side: int) -> tuple[slice, slice]:
    """Return at most ``side`` rows and columns about the median position of a mask (H, W) that is not empty."""

    def about(places: np.ndarray, size: int) -> slice:
        start = int(np.clip(np.median(places) - side // 2, 0, max(0, size - side)))
        return slice(start, min(size, start + side))

    rows, columns = np.nonzero(mask)
    return about(rows, mask.shape[0]), about(columns, mask.shape[1])


def shift_steps(frames: np.ndarray) -> Generator[None, None, np.ndarray]:
    """Return (K, 2) int shifts (right, up) in pixels of frames (K, H, W), 0 if uncertain; yield for each frame.

    Phase correlation (Kuglin and Hines 1975) of gradient magnitudes of log brightness, whose positions do not depend on
    the light, as signs do, between each frame and the mean of the others. Up to 16 pixels are searched. A raking light
    moves edges: so a shift counts only if three basis images of the others explain the frame better after undoing it.
    """
    shifts = np.zeros((len(frames), 2), int)
    reach = min(_MAX_SHIFT, *(side // 4 for side in frames.shape[1:]))
    if len(frames) < 3 or reach < 1:
        return shifts
    features = np.empty(frames.shape, np.float32)
    for frame, out in zip(frames, features, strict=True):
        yield
        out[:] = edge_sizes(frame)
    total = features.sum(axis=0, dtype=np.float64)
    for k, feature in enumerate(features):
        yield
        cross = whitened(np.fft.rfft2(feature) * np.conj(np.fft.rfft2(total - feature)), frames.shape[1:])
        field = np.fft.fftshift(np.fft.irfft2(cross, frames.shape[1:]))
        row, column = (side // 2 for side in field.shape)
        window = field[row - reach : row + reach + 1, column - reach : column + reach + 1]
        up, right = (int(v) - reach for v in np.unravel_index(window.argmax(), window.shape))
        peak, stay = window.max(), field[row, column]
        if peak > 0 and peak - stay >= _SHIFT_GAIN * peak and peak - np.median(window) >= _SHIFT_PEAK * window.std():
            shifts[k] = right, up
    del features, total
    if shifts.any():
        yield from _confirm(frames, shifts)
    return shifts


def _confirm(frames: np.ndarray, shifts: np.ndarray) -> Generator[None, None, None]:
    """Set the shifts (K, 2) to 0 that explain their frames no better than no shift does."""
    shape, moved = frames.shape[1:], shifts.any(axis=1)
    low_pass, window = three_images.low_pass(shape), three_images.fading(shape)

    def blurred(frame: np.ndarray) -> np.ndarray:
        return np.fft.irfft2(np.fft.rfft2(frame / three_images.scale_of(frame)) * low_pass, shape).astype(np.float32)

    flat = np.empty((len(frames), window.size), np.float32)
    for frame, out in zip(frames, flat, strict=True):
        yield
        out[:] = (blurred(frame) * window).ravel()
    products = (flat @ flat.T).astype(np.float64)
    for k in np.flatnonzero(moved):
        yield
        others = np.flatnonzero(~moved)
        if len(others) < three_images.IMAGES:
            others = np.delete(np.arange(len(frames)), k)
        basis, image = three_images.basis(flat, products, others), blurred(frames[k])
        back = np.roll(image, (-shifts[k][1], -shifts[k][0]), axis=(0, 1))
        (before, _), (after, agreement) = (three_images.explained(one, basis, window) for one in (image, back))
        if before <= _BETTER * after or agreement < _AGREE:
            shifts[k] = 0


def whitened(cross: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Normalise a cross spectrum (of ``rfft2`` of frames (H, W)) to magnitude 1, times a Gaussian low pass."""
    low_pass = np.exp(-(np.fft.fftfreq(shape[0])[:, None] ** 2 + np.fft.rfftfreq(shape[1])[None] ** 2) / (2 * _PASS**2))
    size = np.abs(cross)
    return cross * (low_pass / np.maximum(size, 1e-3 * size.max() + 1e-30))


def edge_sizes(frame: np.ndarray) -> np.ndarray:
    """Return (H, W) float32: gradient magnitude of log brightness, capped, with mean 0, faded out toward the border."""
    lit = np.maximum(frame, 0)
    logarithm = np.log(lit + 0.05 * np.percentile(lit, 90) + 1e-9)
    size = np.hypot(*np.gradient(logarithm))
    size = np.minimum(size, np.percentile(size, 99))
    size = (size - size.mean()) / (size.std() + 1e-12)
    rows, columns = (np.hanning(side + 2)[1:-1] for side in frame.shape)
    return (size * rows[:, None] * columns).astype(np.float32)


def lambertian_normals(frames: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return (H, W, 3) unit normals of frames (K, H, W) under directions (K, 3) by least squares (Woodham 1980)."""
    scaled = np.tensordot(np.linalg.pinv(directions), frames, axes=1)
    normals = np.moveaxis(scaled, 0, -1)
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)


def mirror_agreement(normals: np.ndarray, mask: np.ndarray) -> tuple[float, int]:
    """Return (agreement, count): evidence that normals (H, W, 3) are of a surface, not of one mirrored in x or y.

    A surface z(x, y) has ∂p/∂y = ∂q/∂x for p = ∂z/∂x, q = ∂z/∂y; mirroring either axis of the lights, or the rows of
    the images, turns the sign of one side. agreement: the mean of sign(∂p/∂y · ∂q/∂x) over ``count`` squares of 2×2
    texels, −1…1, near 0 for noise. Measured: 0.81, 0.78 and 0.49 on the three bunnies, 0.18 on the icon.
    """
    usable = mask & (normals[..., 2] > 0.2)
    depth = np.where(usable, normals[..., 2], 1)
    p, q = -normals[..., 0] / depth, -normals[..., 1] / depth
    p_y = p[1:, :-1] + p[1:, 1:] - p[:-1, :-1] - p[:-1, 1:]
    q_x = q[:-1, 1:] + q[1:, 1:] - q[:-1, :-1] - q[1:, :-1]
    whole = usable[1:, :-1] & usable[1:, 1:] & usable[:-1, :-1] & usable[:-1, 1:]
    count = int(whole.sum())
    return (float(np.sign(p_y[whole] * q_x[whole]).mean()) if count else 0.0), count


def outward_components(normals: np.ndarray, mask: np.ndarray) -> tuple[float, float, int]:
    """Return (x, y, count): mean components along x and y of border normals in the direction out of the mask.

    The surface of a solid turns away at its outline, so both are above 0; a negative one means a mirrored axis.
    Measured on the bunnies: about 0.2 each. count: border texels, without those at the image's border.
    """
    if min(mask.shape) < 2:
        return 0.0, 0.0, 0
    up, right = np.gradient(mask.astype(float))
    border = mask & (np.hypot(up, right) > 0)
    border[[0, -1]] = border[:, [0, -1]] = False
    count = int(border.sum())
    if not count:
        return 0.0, 0.0, 0
    out = np.stack([-right[border], -up[border]], axis=-1)
    x, y = (normals[border][:, :2] * out).mean(axis=0)
    return float(x), float(y), count
