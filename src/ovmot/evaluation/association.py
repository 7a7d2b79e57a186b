"""Which estimate belongs to which truth: the nearest stamp, within a limit."""

import numpy as np

from ovmot.geometry.arrays import IntArray


def associate_stamps(
    reference_ns: IntArray, estimate_ns: IntArray, max_gap_ns: int
) -> tuple[IntArray, IntArray]:
    """Indices (M,) into both arrays, a pair each, in order of time.

    `reference_ns` (R,) and `estimate_ns` (E,) rise. A pair is made of stamps at most `max_gap_ns`
    apart, each the nearest to the other (the later one where two are as near), so none is used
    twice.
    """
    if len(reference_ns) == 0 or len(estimate_ns) == 0:
        nothing = np.empty(0, dtype=np.int64)
        return nothing, nothing
    of_estimate = _nearest(reference_ns, estimate_ns)
    of_reference = _nearest(estimate_ns, reference_ns)
    index = np.arange(len(estimate_ns))
    mutual = of_reference[of_estimate] == index
    near = np.abs(reference_ns[of_estimate] - estimate_ns) <= max_gap_ns
    kept = mutual & near
    return of_estimate[kept], index[kept]


def _nearest(stamps_ns: IntArray, wanted_ns: IntArray) -> IntArray:
    """For each wanted stamp (M,), the index of the nearest of `stamps_ns` (N,)."""
    after = np.minimum(np.searchsorted(stamps_ns, wanted_ns), len(stamps_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.abs(wanted_ns - stamps_ns[before]) < np.abs(stamps_ns[after] - wanted_ns)
    index: IntArray = np.where(nearer, before, after)
    return index
