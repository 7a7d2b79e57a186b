"""Tracking metrics on the objects of a rendered street, held against TrackEval's figures.

`data/recorded_tracking.json` holds one such sequence with the figures that TrackEval 1.3.0 gives
for it, so that the comparison needs neither the data set nor that tool.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ovmot.datasets.truth import ObjectTruth, TrueObjects, read_ego_truth, read_object_truth
from ovmot.evaluation.matching import (
    ComparedFrame,
    ObjectCriteria,
    compare_frames,
    tracking_sequence,
)
from ovmot.evaluation.tracking import TrackingSequence, clear_mot, hota, identity
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_reader import Tracks

RECORDED = Path(__file__).parent / "data" / "recorded_tracking.json"
CRITERIA = ObjectCriteria()


def tracks_of(truth: ObjectTruth, rng: np.random.Generator) -> Tracks:
    """Tracks of all objects: off by 0.9 m, missing now and then, names swapped, and false ones."""
    name = {object_id: object_id for f in truth.frames.values() for object_id in f.object_id}
    parts = []
    for k, frame in enumerate(truth.frames.values()):
        ids = frame.object_id
        if k % 25 == 20 and len(ids) > 1:
            a, b = rng.choice(ids, 2, replace=False).tolist()
            name[a], name[b] = name[b], name[a]
        if rng.random() < 0.05:
            name[int(rng.choice(ids))] = 100 + k
        found = np.flatnonzero(rng.random(len(ids)) < 0.85)
        position = frame.center[found] + rng.normal(0.0, 0.9, (len(found), 3))
        false = 1000 + np.flatnonzero(rng.random(3) < 0.1)
        near = frame.center[rng.integers(0, len(ids), len(false))]
        parts.append(
            _rows(
                frame,
                np.array([*(name[i] for i in ids[found].tolist()), *false.tolist()]),
                np.concatenate([position, near + rng.normal(0.0, 4.0, near.shape)]),
            )
        )
    columns = zip(*parts, strict=True)
    return Tracks(*(np.concatenate(column) for column in columns))


def _rows(frame: TrueObjects, ids: Any, position: FloatArray) -> tuple[Any, ...]:
    n = len(ids)
    nothing = np.zeros(n)
    return (
        np.full(n, frame.timestamp_ns), ids.astype(np.int64), position, np.zeros((n, 3)), nothing,
        nothing, np.ones((n, 3)), np.ones((n, 6)), np.ones((n, 5)),
    )  # fmt: skip


def objects_of(data: Path) -> ObjectTruth:
    truth = read_object_truth(data)
    assert truth is not None
    return truth


def compare(data: Path, tracks: Tracks) -> tuple[ComparedFrame, ...]:
    """Against the objects of a data set, by the true poses."""
    poses = read_ego_truth(data)
    stamps, T = poses.timestamp_ns, poses.T_world_imu
    return compare_frames(stamps, T, T, objects_of(data), tracks, CRITERIA)


def figures_of_trackeval(sequence: TrackingSequence) -> dict[str, float | list[float]]:
    metrics = pytest.importorskip("trackeval.metrics")
    true_index, n_true, track_index, n_tracks = sequence.numbered()
    data = {
        "gt_ids": true_index, "tracker_ids": track_index,
        "similarity_scores": list(sequence.similarity), "num_timesteps": len(true_index),
        "num_gt_ids": n_true, "num_tracker_ids": n_tracks,
        "num_gt_dets": sum(map(len, true_index)), "num_tracker_dets": sum(map(len, track_index)),
    }  # fmt: skip
    found: dict[str, float | list[float]] = {}
    quiet = {"PRINT_CONFIG": False}
    for metric in (metrics.CLEAR(quiet), metrics.Identity(quiet), metrics.HOTA()):
        for key, value in metric.eval_sequence(data).items():
            found[key] = value.tolist() if isinstance(value, np.ndarray) else float(value)
    return {key: found[key] for key in our_figures(sequence)}


def our_figures(sequence: TrackingSequence) -> dict[str, Any]:
    """The same figures by TrackEval's names."""
    clear, whole, order = clear_mot(sequence), identity(sequence), hota(sequence)
    assert order is not None
    return {
        "MOTA": clear.mota, "MOTP": clear.motp, "CLR_Re": clear.recall, "CLR_Pr": clear.precision,
        "IDSW": clear.id_switches, "Frag": clear.fragmentations, "MT": clear.mostly_tracked,
        "PT": clear.partly_tracked, "ML": clear.mostly_lost,
        "IDF1": whole.idf1, "IDP": whole.precision, "IDR": whole.recall,
        "HOTA": order.hota, "DetA": order.detection, "AssA": order.association,
        "LocA": order.localisation,
    }  # fmt: skip


def assert_same_figures(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert ours.keys() == theirs.keys()
    for key, value in ours.items():
        np.testing.assert_allclose(value, theirs[key], rtol=0.0, atol=1e-6, err_msg=key)


@pytest.fixture(scope="module")
def recorded() -> tuple[TrackingSequence, dict[str, Any]]:
    case = json.loads(RECORDED.read_text())
    true_ids, track_ids, similarity = [], [], []
    for frame in case["frames"]:
        true_ids.append(np.array(frame["true_ids"], dtype=np.int64))
        track_ids.append(np.array(frame["track_ids"], dtype=np.int64))
        values = np.array(frame["similarity"], dtype=np.float64)
        similarity.append(values.reshape(len(true_ids[-1]), len(track_ids[-1])))
    return TrackingSequence(tuple(true_ids), tuple(track_ids), tuple(similarity)), case["figures"]


def test_the_figures_recorded_from_trackeval(
    recorded: tuple[TrackingSequence, dict[str, Any]],
) -> None:
    sequence, figures = recorded
    assert figures["IDSW"] > 5
    assert figures["Frag"] > 20
    assert 0.2 < figures["MOTA"] < 0.9
    assert_same_figures(our_figures(sequence), figures)


def test_the_recorded_figures_are_still_those_of_trackeval(
    recorded: tuple[TrackingSequence, dict[str, Any]],
) -> None:
    sequence, figures = recorded
    assert_same_figures(figures_of_trackeval(sequence), figures)


@pytest.mark.parametrize("scene", ["traffic", "crossing"])
@pytest.mark.parametrize("seed", range(3))
def test_equal_to_trackeval_on_rendered_streets(
    simulated_street: Callable[[str], Path], scene: str, seed: int
) -> None:
    pytest.importorskip("trackeval.metrics")
    data = simulated_street(scene)
    tracks = tracks_of(objects_of(data), np.random.default_rng(seed))
    sequence = tracking_sequence(compare(data, tracks), CRITERIA.gate_m)
    assert_same_figures(our_figures(sequence), figures_of_trackeval(sequence))
