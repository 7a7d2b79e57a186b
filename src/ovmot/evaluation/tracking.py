"""Metrics of multi-object tracking: CLEAR-MOT, identity (IDF1) and HOTA.

All take a `TrackingSequence`; a track and an object can be one from a similarity of 0.5 on (HOTA:
from each of its thresholds on).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from ovmot.geometry.arrays import FloatArray, IntArray

THRESHOLD = 0.5
HOTA_THRESHOLDS: FloatArray = np.arange(0.05, 0.99, 0.05)
_CONTINUED = 1000.0  # more than any similarity: who was matched last stays matched
_EPS = float(np.finfo(np.float64).eps)
_MOSTLY, _PARTLY = 0.8, 0.2


@dataclass(frozen=True, slots=True)
class TrackingSequence:
    """F frames: ids of true objects (N_f,), of tracks (P_f,), similarities (N_f, P_f) in 0..1."""

    true_ids: tuple[IntArray, ...]
    track_ids: tuple[IntArray, ...]
    similarity: tuple[FloatArray, ...]

    def numbered(self) -> tuple[list[IntArray], int, list[IntArray], int]:
        """Ids as indices from 0 on, per frame, and how many there are: of objects, of tracks."""
        true_index, n_true = _numbered(self.true_ids)
        track_index, n_tracks = _numbered(self.track_ids)
        return true_index, n_true, track_index, n_tracks


@dataclass(frozen=True, slots=True)
class ClearMot:
    """Counts and rates of CLEAR-MOT (K. Bernardin & R. Stiefelhagen, EURASIP JIVP 2008).

    `motp` is the mean similarity of matched pairs. `mostly_tracked`, `partly_tracked` and
    `mostly_lost` count objects by the share of their frames in which they are matched: over 80 %,
    from 20 % on, below. A rate without anything to count is None.
    """

    n_true: int
    n_tracks: int
    hits: int
    misses: int
    false_positives: int
    id_switches: int
    fragmentations: int
    mostly_tracked: int
    partly_tracked: int
    mostly_lost: int
    motp: float | None

    @property
    def mota(self) -> float | None:
        wrong = self.misses + self.false_positives + self.id_switches
        return 1.0 - wrong / self.n_true if self.n_true else None

    @property
    def recall(self) -> float | None:
        return self.hits / self.n_true if self.n_true else None

    @property
    def precision(self) -> float | None:
        return self.hits / self.n_tracks if self.n_tracks else None


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity metrics: each object is one track or none (E. Ristani et al., ECCV-W 2016)."""

    true_positives: int
    false_positives: int
    false_negatives: int

    @property
    def idf1(self) -> float | None:
        total = 2 * self.true_positives + self.false_positives + self.false_negatives
        return 2 * self.true_positives / total if total else None

    @property
    def precision(self) -> float | None:
        total = self.true_positives + self.false_positives
        return self.true_positives / total if total else None

    @property
    def recall(self) -> float | None:
        total = self.true_positives + self.false_negatives
        return self.true_positives / total if total else None


@dataclass(frozen=True, slots=True)
class Hota:
    """HOTA and its parts (J. Luiten et al., IJCV 2021), each (A,) over `HOTA_THRESHOLDS`."""

    hota: FloatArray
    detection: FloatArray
    association: FloatArray
    localisation: FloatArray


def clear_mot(sequence: TrackingSequence) -> ClearMot:
    """Match frame by frame, preferring the track that an object had in the frame before."""
    true_index, n_true, track_index, _ = sequence.numbered()
    last_frame = np.full(n_true, -1, dtype=np.int64)
    last_match = np.full(n_true, -1, dtype=np.int64)
    present, matched, resumed = (np.zeros(n_true, dtype=np.int64) for _ in range(3))
    switches, similarity_sum = 0, 0.0
    for objects, tracks, similarity in zip(
        true_index, track_index, sequence.similarity, strict=True
    ):
        present[objects] += 1
        if len(objects) == 0 or len(tracks) == 0:
            continue  # as TrackEval has it: such a frame breaks no track
        possible = similarity >= THRESHOLD - _EPS
        continued = last_frame[objects][:, None] == tracks[None, :]
        score = np.where(possible, similarity + _CONTINUED * continued, 0.0)
        i, j = linear_sum_assignment(-score)
        i, j = i[possible[i, j]], j[possible[i, j]]
        who, by = objects[i], tracks[j]
        switches += int(np.count_nonzero((last_match[who] >= 0) & (last_match[who] != by)))
        similarity_sum += float(similarity[i, j].sum())
        matched[who] += 1
        resumed[who] += last_frame[who] < 0
        last_match[who] = by
        last_frame[:] = -1
        last_frame[who] = by
    share = matched / np.maximum(present, 1)
    n_boxes, n_tracks = int(present.sum()), sum(len(t) for t in track_index)
    hits = int(matched.sum())
    mostly = int(np.count_nonzero(share > _MOSTLY))
    partly = int(np.count_nonzero(share >= _PARTLY)) - mostly
    return ClearMot(
        n_true=n_boxes,
        n_tracks=n_tracks,
        hits=hits,
        misses=n_boxes - hits,
        false_positives=n_tracks - hits,
        id_switches=switches,
        fragmentations=int(np.maximum(resumed - 1, 0).sum()),
        mostly_tracked=mostly,
        partly_tracked=partly,
        mostly_lost=n_true - mostly - partly,
        motp=similarity_sum / hits if hits else None,
    )


def identity(sequence: TrackingSequence) -> Identity:
    """Assign whole tracks to whole objects so that most boxes agree."""
    true_index, n_true, track_index, n_tracks = sequence.numbered()
    together = np.zeros((n_true, n_tracks))
    for objects, tracks, similarity in zip(
        true_index, track_index, sequence.similarity, strict=True
    ):
        together[np.ix_(objects, tracks)] += similarity >= THRESHOLD
    i, j = linear_sum_assignment(-together)
    hits = int(together[i, j].sum())
    n_boxes, n_rows = sum(map(len, true_index)), sum(map(len, track_index))
    return Identity(hits, n_rows - hits, n_boxes - hits)


def hota(sequence: TrackingSequence) -> Hota | None:
    """HOTA at each threshold; None where there is neither an object nor a track."""
    true_index, n_true, track_index, n_tracks = sequence.numbered()
    if n_true == 0 and n_tracks == 0:
        return None
    true_count = np.bincount(_joined(true_index), minlength=n_true)[:, None]
    track_count = np.bincount(_joined(track_index), minlength=n_tracks)[None, :]
    alignment = _alignment(sequence, true_index, track_index, true_count, track_count)
    together = np.zeros((len(HOTA_THRESHOLDS), n_true, n_tracks))
    located = np.zeros(len(HOTA_THRESHOLDS))
    for objects, tracks, similarity in zip(
        true_index, track_index, sequence.similarity, strict=True
    ):
        i, j = linear_sum_assignment(-alignment[np.ix_(objects, tracks)] * similarity)
        for a, threshold in enumerate(HOTA_THRESHOLDS):
            kept = similarity[i, j] >= threshold - _EPS
            together[a, objects[i[kept]], tracks[j[kept]]] += 1
            located[a] += similarity[i[kept], j[kept]].sum()
    hits = together.sum(axis=(1, 2))
    union = true_count + track_count - together
    associated = (together * together / np.maximum(union, 1.0)).sum(axis=(1, 2))
    association = associated / np.maximum(hits, 1.0)
    detection = hits / np.maximum(true_count.sum() + track_count.sum() - hits, 1.0)
    localisation = np.where(hits > 0, located / np.maximum(hits, 1.0), 1.0)
    return Hota(np.sqrt(detection * association), detection, association, localisation)


def _alignment(
    sequence: TrackingSequence,
    true_index: list[IntArray],
    track_index: list[IntArray],
    true_count: IntArray,
    track_count: IntArray,
) -> FloatArray:
    """How much object and track (n_true, n_tracks) overlap over the whole sequence, 0 to 1."""
    shared = np.zeros((len(true_count), track_count.shape[1]))
    for objects, tracks, similarity in zip(
        true_index, track_index, sequence.similarity, strict=True
    ):
        union = similarity.sum(axis=0)[None, :] + similarity.sum(axis=1)[:, None] - similarity
        part = np.where(union > _EPS, similarity / np.where(union > _EPS, union, 1.0), 0.0)
        shared[np.ix_(objects, tracks)] += part
    return np.asarray(shared / np.maximum(true_count + track_count - shared, _EPS))


def _numbered(ids: tuple[IntArray, ...]) -> tuple[list[IntArray], int]:
    known = np.unique(_joined(list(ids)))
    return [np.searchsorted(known, frame).astype(np.int64) for frame in ids], len(known)


def _joined(frames: list[IntArray]) -> IntArray:
    return np.concatenate([np.empty(0, dtype=np.int64), *frames]).astype(np.int64)
