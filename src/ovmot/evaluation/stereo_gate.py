"""Verdicts of the stereo gate against the true depth: precision and recall of accepted matches."""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.truth import ObjectTruth
from ovmot.evaluation.labels import pixel_index
from ovmot.geometry import se3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.outputs.run_reader import GatedMatches

RIGHT_WITHIN_PX = 3.0
_STEP = 0.05
"""Where neighbouring depths differ by more than this share, whose depth it is, is unsure."""


@dataclass(frozen=True, slots=True)
class GateCounts:
    """Matches that lie where the true depth puts them (`right`), or do not, and the verdict.

    A wrong match that is accepted lies on its epipolar line: no gate made of the extrinsics can
    see it.
    """

    right_accepted: int
    right_refused: int
    wrong_accepted: int
    wrong_refused: int

    @property
    def precision(self) -> float | None:
        """Share of the accepted matches that are right."""
        accepted = self.right_accepted + self.wrong_accepted
        return self.right_accepted / accepted if accepted else None

    @property
    def recall(self) -> float | None:
        """Share of the right matches that are accepted."""
        right = self.right_accepted + self.right_refused
        return self.right_accepted / right if right else None

    @property
    def wrong_refused_share(self) -> float | None:
        """Share of the wrong matches that are refused."""
        wrong = self.wrong_accepted + self.wrong_refused
        return self.wrong_refused / wrong if wrong else None


def count_gate(matches: GatedMatches, truth: ObjectTruth, rig: StereoRig) -> GateCounts:
    """Compare the gate's verdicts with where each left pixel's true depth puts it on the right.

    Left out are pixels without a depth (sky) and those at a step of depth.
    """
    counts = np.zeros((2, 2), dtype=np.int64)
    for stamp in np.unique(matches.timestamp_ns).tolist():
        if stamp not in truth.frames:
            continue
        rows = matches.timestamp_ns == stamp
        right, known = is_right(matches.pixels[rows], truth.read_depth(stamp), rig)
        verdict = matches.accepted[rows]
        index = (right[known].astype(np.int64), verdict[known].astype(np.int64))
        np.add.at(counts, index, 1)
    return GateCounts(
        right_accepted=int(counts[1, 1]), right_refused=int(counts[1, 0]),
        wrong_accepted=int(counts[0, 1]), wrong_refused=int(counts[0, 0]),
    )  # fmt: skip


def is_right(pixels: FloatArray, depth: FloatArray, rig: StereoRig) -> tuple[BoolArray, BoolArray]:
    """Which matches (M, 4) are within `RIGHT_WITHIN_PX` of the truth, and where that is known."""
    at, inside = pixel_index(pixels[:, :2], depth)
    z = depth[at]
    known = inside & np.isfinite(z)
    for dv, du in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        v = np.clip(at[0] + dv, 0, depth.shape[0] - 1)
        u = np.clip(at[1] + du, 0, depth.shape[1] - 1)
        with np.errstate(invalid="ignore"):
            known &= np.abs(depth[v, u] - z) < _STEP * z
    xy = rig.cam0.normalize(pixels[:, :2])
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    there = rig.cam1.project(se3.apply(rig.T_cam1_cam0, z[:, None] * rays))
    off = np.linalg.norm(pixels[:, 2:] - there, axis=1)
    known &= np.isfinite(off)
    return np.asarray(off <= RIGHT_WITHIN_PX), known
