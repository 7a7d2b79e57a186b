"""The first patch of each feature: what it looked like when first seen.

Frame-to-frame flow adds up its errors, and a window that only shifts does not fit ground that is
seen at a slant: from one frame to the next, and from left to right, it drifts. Each feature
therefore keeps its first patch, and every match is refined against it under an affine warp (J. Shi
& C. Tomasi, CVPR 1994) by inverse compositional Gauss-Newton steps (S. Baker & I. Matthews, IJCV
2004). Patches are compared with zero mean and unit norm, under a Gaussian weight around the centre.
"""

import numpy as np

from ovmot.frontend.feature_kernel import cut_patches_compiled
from ovmot.frontend.patch_kernel import PADDED, Patch, Quads
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray, IntArray


class PatchStore:
    """The patches of one camera's features, each in a slot that its feature keeps.

    `patches`: S of them in each array of a `Patch`; `warp` (S, 2, 2): an offset x in the patch is
    now seen at uv + warp x; `is_new` (S,): cut in the newest image.
    """

    def __init__(self) -> None:
        self.patches = no_patches()
        self.warp: FloatArray = np.empty((0, 2, 2))
        self.is_new: BoolArray = np.empty(0, dtype=np.bool_)
        self._in_use: BoolArray = np.empty(0, dtype=np.bool_)

    def add(self, words: Quads, uv: FloatArray) -> IntArray:
        """Slots (N,) of new patches around pixels `uv` (N, 2) of an image in words."""
        free = np.flatnonzero(~self._in_use)
        if len(free) < len(uv):
            self._grow(len(self._in_use) + len(uv))
            free = np.flatnonzero(~self._in_use)
        slot: IntArray = free[: len(uv)]
        self._in_use[slot] = True
        self.renew(words, uv, slot)
        return slot

    def renew(self, words: Quads, uv: FloatArray, slot: IntArray, *, damping: float = 1e-3) -> None:
        """Cut the patches at `slot` (N,) anew around pixels `uv` (N, 2) of an image in words.

        `damping`, a share of the mean curvature, keeps texture along one direction from running
        away along the other.
        """
        cut_patches_compiled(words, uv, slot, self.patches, damping)
        self.warp[slot] = np.eye(2)
        self.is_new[slot] = True

    def keep(self, slot: IntArray) -> None:
        """Free all slots but these (N,)."""
        self._in_use[:] = False
        self._in_use[slot] = True

    def _grow(self, size: int) -> None:
        """Room for at least `size` patches, and twice as many as before."""
        more = max(size, 2 * len(self._in_use)) - len(self._in_use)

        def grown(values: AnyArray) -> AnyArray:
            return np.concatenate([values, np.zeros((more, *values.shape[1:]), values.dtype)])

        self.patches, self.warp = Patch(*map(grown, self.patches)), grown(self.warp)
        self.is_new, self._in_use = grown(self.is_new), grown(self._in_use)


def no_patches() -> Patch:
    """Arrays of no patch."""
    shapes = (0, PADDED), (0, 2, PADDED), (0, 6, 2), (0, 6, 6)
    return Patch(*(np.empty(shape, dtype=np.float32) for shape in shapes))
