"""Tracking metrics: equal to TrackEval's, and right where the answer is known."""

from typing import Any

import numpy as np
import pytest

from ovmot.evaluation.tracking import TrackingSequence, clear_mot, hota, identity


def noisy_sequence(seed: int, n_frames: int = 60) -> TrackingSequence:
    """Objects that come and go; tracks with misses, false ones, id swaps and odd similarities."""
    rng = np.random.default_rng(seed)
    begin, length = rng.integers(0, 40, 7), rng.integers(5, 40, 7)
    name = {o: 10 + o for o in range(7)}
    true_ids, track_ids, similarities = [], [], []
    for frame in range(n_frames):
        objects = np.flatnonzero((begin <= frame) & (frame < begin + length))
        if rng.random() < 0.1 and len(objects) > 1:
            a, b = rng.choice(objects, 2, replace=False).tolist()
            name[a], name[b] = name[b], name[a]
        if rng.random() < 0.05 and len(objects):
            name[int(rng.choice(objects))] = 100 + frame
        found = objects[rng.random(len(objects)) < 0.85]
        false = 1000 + np.flatnonzero(rng.random(3) < 0.2)
        tracks = np.array([*(name[int(o)] for o in found), *false], dtype=np.int64)
        similarity = rng.uniform(0.0, 0.45, (len(objects), len(tracks)))
        for k, o in enumerate(found):
            similarity[np.flatnonzero(objects == o)[0], k] = rng.uniform(0.35, 1.0)
        order = rng.permutation(len(tracks))
        true_ids.append(objects.astype(np.int64))
        track_ids.append(tracks[order])
        similarities.append(similarity[:, order])
    return TrackingSequence(tuple(true_ids), tuple(track_ids), tuple(similarities))


def as_trackeval(sequence: TrackingSequence) -> dict[str, Any]:
    true_index, n_true, track_index, n_tracks = sequence.numbered()
    return {
        "gt_ids": true_index,
        "tracker_ids": track_index,
        "similarity_scores": list(sequence.similarity),
        "num_timesteps": len(true_index),
        "num_gt_ids": n_true,
        "num_tracker_ids": n_tracks,
        "num_gt_dets": sum(map(len, true_index)),
        "num_tracker_dets": sum(map(len, track_index)),
    }


@pytest.mark.parametrize("seed", range(6))
def test_equal_to_trackeval(seed: int) -> None:
    metrics = pytest.importorskip("trackeval.metrics")
    sequence = noisy_sequence(seed)
    data = as_trackeval(sequence)
    quiet = {"PRINT_CONFIG": False}

    theirs = metrics.HOTA().eval_sequence(data)
    ours = hota(sequence)
    assert ours is not None
    for name, value in (
        ("HOTA", ours.hota), ("DetA", ours.detection), ("AssA", ours.association),
        ("LocA", ours.localisation),
    ):  # fmt: skip
        np.testing.assert_allclose(value, theirs[name], atol=1e-9)

    theirs = metrics.CLEAR(quiet).eval_sequence(data)
    clear = clear_mot(sequence)
    assert (clear.hits, clear.misses) == (theirs["CLR_TP"], theirs["CLR_FN"])
    assert clear.false_positives == theirs["CLR_FP"]
    assert clear.id_switches == theirs["IDSW"]
    assert clear.fragmentations == theirs["Frag"]
    assert clear.mostly_tracked == theirs["MT"]
    assert clear.partly_tracked == theirs["PT"]
    assert clear.mostly_lost == theirs["ML"]
    for rate, name in (
        (clear.mota, "MOTA"), (clear.motp, "MOTP"), (clear.recall, "CLR_Re"),
        (clear.precision, "CLR_Pr"),
    ):  # fmt: skip
        assert rate == pytest.approx(theirs[name], abs=1e-9)

    theirs = metrics.Identity(quiet).eval_sequence(data)
    found = identity(sequence)
    for rate, name in ((found.idf1, "IDF1"), (found.precision, "IDP"), (found.recall, "IDR")):
        assert rate == pytest.approx(theirs[name], abs=1e-9)
    assert found.true_positives == theirs["IDTP"]


def test_the_cases_are_not_trivial() -> None:
    clear = [clear_mot(noisy_sequence(seed)) for seed in range(6)]
    assert sum(c.id_switches for c in clear) > 20
    assert sum(c.fragmentations for c in clear) > 20
    assert all(c.mota is not None and 0.0 < c.mota < 0.95 for c in clear)


def perfect() -> TrackingSequence:
    ids = tuple(np.arange(3) for _ in range(10))
    return TrackingSequence(ids, ids, tuple(np.eye(3) for _ in range(10)))


def test_perfect_tracks_score_one() -> None:
    clear, found, h = clear_mot(perfect()), identity(perfect()), hota(perfect())
    assert (clear.mota, clear.motp, clear.recall, clear.precision) == (1.0, 1.0, 1.0, 1.0)
    assert (clear.id_switches, clear.fragmentations, clear.mostly_tracked) == (0, 0, 3)
    assert found.idf1 == 1.0
    assert h is not None
    np.testing.assert_allclose([h.hota.min(), h.localisation.min()], 1.0)


def test_one_change_of_name_is_one_switch() -> None:
    p = perfect()
    renamed = tuple(np.array([0, 1, 2 if k < 5 else 7]) for k in range(10))
    sequence = TrackingSequence(p.true_ids, renamed, p.similarity)
    assert clear_mot(sequence).id_switches == 1
    assert clear_mot(sequence).recall == 1.0
    assert identity(sequence).true_positives == 25


def test_the_names_of_tracks_do_not_matter() -> None:
    a = noisy_sequence(3)
    b = TrackingSequence(a.true_ids, tuple(7 * t + 3 for t in a.track_ids), a.similarity)
    assert clear_mot(a) == clear_mot(b)
    assert identity(a) == identity(b)
    ours, other = hota(a), hota(b)
    assert ours is not None and other is not None
    np.testing.assert_array_equal(ours.hota, other.hota)


def test_nothing_found_and_nothing_there() -> None:
    none, two = np.empty(0, dtype=np.int64), np.arange(2)
    missed = TrackingSequence((two, two), (none, none), (np.empty((2, 0)),) * 2)
    assert (clear_mot(missed).recall, clear_mot(missed).precision) == (0.0, None)
    assert (clear_mot(missed).mostly_lost, identity(missed).idf1) == (2, 0.0)
    h = hota(missed)
    assert h is not None
    assert h.hota.max() == 0.0
    empty = TrackingSequence((none,), (none,), (np.empty((0, 0)),))
    assert (clear_mot(empty).mota, identity(empty).idf1, hota(empty)) == (None, None, None)
    false = TrackingSequence((none,), (two,), (np.empty((0, 2)),))
    assert (clear_mot(false).recall, clear_mot(false).precision) == (None, 0.0)
