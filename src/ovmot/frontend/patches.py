"""Affine alignment of patches with what they looked like when first seen.

Frame-to-frame flow adds up its errors, and a window that only shifts does not fit ground that is
seen at a slant: from one frame to the next, and from left to right, it drifts. Each feature
therefore keeps its first patch, and every match is refined against it under an affine warp (J. Shi
& C. Tomasi, CVPR 1994) by inverse compositional Gauss-Newton steps (S. Baker & I. Matthews, IJCV
2004), on all features at once. Patches are compared with zero mean and unit norm, under a Gaussian
weight around the centre.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from ovmot.frontend.klt_kernel import MAX_STEPS, SMALL_STEP_PX
from ovmot.frontend.optical_flow import MIN_CORRELATION
from ovmot.frontend.patch_kernel import align_points_compiled
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, IntArray

_Float32 = npt.NDArray[np.float32]

_RADIUS = 6
"""Pixels from the centre of a patch to its border: it is 13 wide, 2 more than a window of flow."""


def _square(radius: int) -> _Float32:
    """Offsets (M, 2) in pixels of a square patch from its centre, by rows."""
    axis = np.arange(-radius, radius + 1, dtype=np.float32)
    return np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)


def _root_weight(offsets: _Float32, sigma_px: float) -> _Float32:
    """Square roots (M,) of a Gaussian weight: what lies off the centre counts less, since at an
    outline it belongs to another body."""
    return np.asarray(np.exp(-0.25 * (offsets**2).sum(axis=1) / sigma_px**2), dtype=np.float32)


_OFFSETS = _square(_RADIUS)
_BY_AXIS: _Float32 = np.ascontiguousarray(_OFFSETS.T)
_SIGMA_PX = _RADIUS / 2
"""Of the weight, as D. Lowe has it for descriptors (IJCV 2004): half of the patch's half width. A
patch that moves by more than this from where flow has put it has found another one."""
_ROOT_WEIGHT = _root_weight(_OFFSETS, _SIGMA_PX)


@dataclass(frozen=True, slots=True)
class Patches:
    """N patches of M pixels: `grey` (N, M), weighted, of zero mean and unit norm; `steepest`
    (N, 6, M), its derivative by a shift (2) and by the warp's four numbers times the radius;
    `inverse` (N, 6, 6) of the curvature; `warp` (N, 2, 2): an offset x in the patch is now seen at
    uv + warp x."""

    grey: _Float32
    steepest: _Float32
    inverse: _Float32
    warp: FloatArray

    def __len__(self) -> int:
        return len(self.grey)

    def rows(self, kept: BoolArray | IntArray) -> "Patches":
        """Some of them."""
        return Patches(
            self.grey[kept], self.steepest[kept], self.inverse[kept], self.warp[kept]
        )  # fmt: skip

    def joined(self, others: "Patches") -> "Patches":
        """These, and others after them."""
        return Patches(
            np.concatenate([self.grey, others.grey]),
            np.concatenate([self.steepest, others.steepest]),
            np.concatenate([self.inverse, others.inverse]),
            np.concatenate([self.warp, others.warp]),
        )

    def put(self, where: BoolArray, others: "Patches") -> "Patches":
        """These, with the others in place of those `where` (N,) is true."""

        def replaced(values: AnyArray, new: AnyArray) -> AnyArray:
            out = values.copy()
            out[where] = new
            return out

        return Patches(
            replaced(self.grey, others.grey),
            replaced(self.steepest, others.steepest),
            replaced(self.inverse, others.inverse),
            replaced(self.warp, others.warp),
        )


def cut_patches(image: _Float32, uv: FloatArray, *, damping: float = 1e-3) -> Patches:
    """Patches around pixels (N, 2) of a smoothed image (height, width), as they are seen there.

    `damping`, a share of the mean curvature, keeps texture along one direction from running away
    along the other.
    """
    n, side = len(uv), 2 * _RADIUS + 3
    identity = np.broadcast_to(np.eye(2), (n, 2, 2))
    wide = _sample(image, uv, identity, _square(_RADIUS + 1)).reshape(n, side, side)
    grey, norm = weighted_unit(wide[:, 1:-1, 1:-1].reshape(n, len(_OFFSETS)))
    by_u = 0.5 * (wide[:, 1:-1, 2:] - wide[:, 1:-1, :-2]).reshape(n, len(_OFFSETS)) / norm
    by_v = 0.5 * (wide[:, 2:, 1:-1] - wide[:, :-2, 1:-1]).reshape(n, len(_OFFSETS)) / norm
    x, y = _OFFSETS[:, 0] / _RADIUS, _OFFSETS[:, 1] / _RADIUS
    steepest = np.stack([by_u, by_v, by_u * x, by_u * y, by_v * x, by_v * y], axis=1)
    weight = _ROOT_WEIGHT**2 / (_ROOT_WEIGHT**2).sum()
    steepest = (steepest - (steepest @ weight)[..., None]) * _ROOT_WEIGHT
    steepest -= (steepest @ grey[..., None]) * grey[:, None]  # what a gain would explain
    H = steepest @ np.swapaxes(steepest, 1, 2)
    added = damping * np.trace(H, axis1=1, axis2=2) / 6.0 + 1e-9
    inverse = np.linalg.inv(H + added[:, None, None] * np.eye(6, dtype=np.float32))
    return Patches(grey, steepest, inverse.astype(np.float32), identity.copy())


def no_patches() -> Patches:
    """None yet."""
    return cut_patches(np.zeros((1, 1), dtype=np.float32), np.empty((0, 2)))


def align(
    patches: Patches,
    image: _Float32,
    start: FloatArray,
    start_warp: FloatArray,
    workers: Executor,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where the patches are in a smoothed image: uv (N, 2), warps (N, 2, 2), and which fit (N,).

    From pixels `start` (N, 2) and `start_warp` (N, 2, 2); what does not fit may be anywhere. Halves
    of the points run in two threads, each point by itself: the result does not depend on that.
    """
    uv, warp = start.astype(np.float64), start_warp.astype(np.float64)
    half = (len(uv) + 1) // 2
    parts = [slice(0, half), slice(half, None)]
    jobs = [
        workers.submit(
            align_points_compiled, image, patches.grey[part], patches.steepest[part],
            patches.inverse[part], _ROOT_WEIGHT, _BY_AXIS, uv[part], warp[part],
            MAX_STEPS, SMALL_STEP_PX, _SIGMA_PX,
        )
        for part in parts
    ]  # fmt: skip
    correlation = np.concatenate([job.result() for job in jobs])
    shift = np.linalg.norm(uv - start, axis=1)
    with np.errstate(invalid="ignore"):
        fits = (shift < _SIGMA_PX) & (correlation > MIN_CORRELATION)
    return uv, warp, fits


def refine_tracked(
    patches: Patches,
    image: _Float32,
    start: FloatArray,
    workers: Executor,
    *,
    max_scale: float = 1.7,
) -> tuple[FloatArray, Patches]:
    """Refined pixels (N, 2) in the next smoothed image, and the patches as they are seen there.

    `start` (N, 2): positions by optical flow. Patches that do not fit any more stay there; these,
    and those that are seen larger or smaller by more than `max_scale`, are cut anew.
    """
    uv, warp, fits = align(patches, image, start, patches.warp, workers)
    uv = np.where(fits[:, None], uv, start)
    scale = np.linalg.svd(np.where(fits[:, None, None], warp, np.eye(2)), compute_uv=False)
    stale = ~fits | (scale.max(axis=1) > max_scale) | (scale.min(axis=1) < 1.0 / max_scale)
    out = replace(patches, warp=warp)
    if stale.any():
        out = out.put(stale, cut_patches(image, uv[stale]))
    return uv, out


def _sample(image: _Float32, uv: FloatArray, warp: FloatArray, offsets: _Float32) -> _Float32:
    """Grey levels (N, M) at uv + warp offset; the image continued by its border."""
    if not len(uv):
        return np.empty((0, len(offsets)), dtype=np.float32)
    where = uv[:, None].astype(np.float32) + offsets @ np.swapaxes(warp, 1, 2).astype(np.float32)
    sampled = cv2.remap(
        image, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(sampled, dtype=np.float32)


def weighted_unit(grey: _Float32) -> tuple[_Float32, _Float32]:
    """Rows (N, M) less their weighted mean, by root weight, of unit norm; and that norm (N, 1)."""
    weight = _ROOT_WEIGHT**2 / (_ROOT_WEIGHT**2).sum()
    grey = (grey - (grey * weight).sum(axis=1, keepdims=True)) * _ROOT_WEIGHT
    norm = np.maximum(np.linalg.norm(grey, axis=1, keepdims=True), np.float32(1e-3))
    return grey / norm, norm
