"""Features that were lost and may be seen again: their patches, and other features that show them.

A body that comes out from behind another one shows the corners that it had before. They are
compared, by their first patches, with the features around the places where the body has them now.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from typing import NamedTuple

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.frontend.feature_search import LIKELY_CORRELATION, RATIO, Sought, find_features
from ovmot.frontend.patch_kernel import RADIUS
from ovmot.frontend.patches import PatchStore
from ovmot.frontend.preprocessing import View
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.interfaces import HiddenFeatures
from ovmot.physics import gate

REPLY_FRAMES = 3
"""Frames after which the objects' word on a lost feature is there: they work two frames behind."""
_LEAST = 3
"""Features that show a body again: two of a texture that repeats itself are soon found."""
_MOST_PAIRS = 256
"""Pairs that propose a displacement, the likeliest: a bound on the work before a wall of tiles."""
_NEAR = float(np.sqrt(gate(2, 0.99)))
"""Standard deviations of the predicted place."""


class HiddenPatches(NamedTuple):
    """L lost features: ids, the slots of their patches, and for how many frames they are lost."""

    feature_id: IntArray
    slot: IntArray
    n_frames: IntArray


class ExpectedPlaces(NamedTuple):
    """Where L hidden features are expected: ids, numbers (L,) of their bodies, places `p_now`
    (L, 3) in the camera, metres, and their standard deviations (L,) in any direction."""

    feature_id: IntArray
    body: IntArray
    p_now: FloatArray
    sigma_m: FloatArray


class SeenAgain(NamedTuple):
    """K hidden features that K of the others show: rows of both, pixels `uv` (K, 2) and warps
    (K, 2, 2) of the patches."""

    hidden: IntArray
    other: IntArray
    uv: FloatArray
    warp: FloatArray


def none_hidden() -> HiddenPatches:
    """That of a first image."""
    none = np.empty(0, np.int64)
    return HiddenPatches(none, none, none)


def none_expected() -> ExpectedPlaces:
    """Of no body."""
    none = np.empty(0, np.int64)
    return ExpectedPlaces(none, none, np.empty((0, 3)), np.empty(0))


def expected_places(
    hidden: HiddenFeatures, now_ns: int, steps: Sequence[tuple[int, FloatArray]]
) -> ExpectedPlaces:
    """Where features of bodies are expected in the camera of now.

    `steps`: the stamps of the last frames, and the camera's motion (4, 4) to each from the one
    before. None is expected if the bodies' frame is none of them.
    """
    T, known = np.eye(4), False
    for stamp_ns, step in reversed(steps):
        known = stamp_ns == hidden.timestamp_ns
        if known:
            break
        T = T @ step
    if not known:
        return none_expected()
    dt_s = 1e-9 * (now_ns - hidden.timestamp_ns)
    p = se3.apply(T, hidden.p_cam0 + dt_s * hidden.velocity)
    return ExpectedPlaces(hidden.feature_id, hidden.body, p, hidden.sigma_m)


def hidden_now(
    before: HiddenPatches, lost_id: IntArray, lost_slot: IntArray, wanted: IntArray
) -> HiddenPatches:
    """Those before and the ones lost in this image (K,), as long as somebody may ask for them.

    `wanted` (L,): ids that bodies expect. The others are kept until the objects have seen that they
    are lost.
    """
    age = before.n_frames + 1
    kept = (age <= REPLY_FRAMES) | contained(before.feature_id, np.sort(wanted))
    return HiddenPatches(
        np.concatenate([before.feature_id[kept], lost_id]),
        np.concatenate([before.slot[kept], lost_slot]),
        np.concatenate([age[kept], np.zeros(len(lost_id), np.int64)]),
    )


def seen_again(
    hidden: HiddenPatches, expected: ExpectedPlaces, store: PatchStore, view: View,
    uv: FloatArray, slot: IntArray, helper: Executor,
) -> SeenAgain:  # fmt: skip
    """Which features at pixels `uv` (N, 2), with patches at `slot` (N,), show hidden ones.

    A body's texture repeats itself, so one patch alone tells nothing: the features of a body must
    all be found at one displacement from where they are expected (`common_displacement`), and the
    first patch of each must fit there.
    """
    _, row, at = np.intersect1d(hidden.feature_id, expected.feature_id, return_indices=True)
    pairs = [np.empty((2, 0), np.int64)]
    if len(uv):
        expected_uv, reach_px = places_in_image(expected, view.camera)
        grey = store.patches.grey
        for body in np.unique(expected.body[at]):
            own = expected.body[at] == body
            alike = grey[hidden.slot[row[own]]] @ grey[slot].T
            off = uv[None] - expected_uv[at[own]][:, None]
            near = np.linalg.norm(off, axis=2) < reach_px[at[own], None]
            which, corner = common_displacement(np.where(near, alike, 0.0), off)
            pairs.append(np.stack([row[own][which], corner]))
    old, other = np.concatenate(pairs, axis=1)
    start, old_slot = uv[other], hidden.slot[old]
    found = find_features(Sought(view.pyramid, start, store, old_slot), view, start, 0, helper)
    fits = found.found & found.fits
    return SeenAgain(old[fits], other[fits], found.uv[fits], found.warp[fits])


def places_in_image(expected: ExpectedPlaces, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Pixels (L, 2), NaN behind the camera, and how far from them features may be (L,)."""
    depth = np.maximum(expected.p_now[:, 2], expected.sigma_m)
    return camera.project(expected.p_now), _NEAR * camera.fx * expected.sigma_m / depth


def common_displacement(alike: FloatArray, off_px: FloatArray) -> tuple[IntArray, IntArray]:
    """Pairs (K,), (K,) of L features and N corners by which most of a body is displaced alike.

    `alike` (L, N): correlations of their patches, `off_px` (L, N, 2): from the expected places.
    Each likely pair proposes its displacement, and is rated by the sum of the features' best
    correlations at it, up to half of a patch. None is taken with less than `_LEAST` features, nor
    if another displacement is rated nearly as well (D. Lowe's ratio).
    """
    feature, corner = np.nonzero(alike > LIKELY_CORRELATION)
    none = np.empty(0, np.int64)
    if len(feature) < _LEAST:
        return none, none
    weight = alike[feature, corner]
    likeliest = np.argsort(-weight, kind="stable")[:_MOST_PAIRS]
    feature, corner, weight = feature[likeliest], corner[likeliest], weight[likeliest]
    off = off_px[feature, corner]
    agrees = np.linalg.norm(off[None] - off[:, None], axis=2) < RADIUS
    rating = np.zeros((len(off), len(alike)))
    for k in range(len(off)):
        np.maximum.at(rating[k], feature[agrees[k]], weight[agrees[k]])
    total = rating.sum(axis=1)
    best = int(total.argmax())
    elsewhere = np.linalg.norm(off - off[best], axis=1) > 2.0 * RADIUS
    if np.count_nonzero(rating[best]) < _LEAST or (
        elsewhere.any() and total[elsewhere].max() > RATIO * total[best]
    ):
        return none, none
    # the likeliest corner of each feature, and each corner once
    order = np.flatnonzero(agrees[best])[np.argsort(-weight[agrees[best]], kind="stable")]
    order = order[np.sort(np.unique(feature[order], return_index=True)[1])]
    order = order[np.sort(np.unique(corner[order], return_index=True)[1])]
    return feature[order], corner[order]
