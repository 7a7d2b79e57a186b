"""The map: paths and tracks in the truth's world."""

import numpy as np
from true_objects import objects_at, tracks_at

from ovmot.evaluation.ego import EgoSeries
from ovmot.evaluation.map_plot import map_figure
from ovmot.evaluation.matching import ObjectCriteria, compare_frame
from ovmot.geometry import se3

PATH = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=-1)
SERIES = EgoSeries(
    10**8 * np.arange(5, dtype=np.int64), np.zeros((5, 6)), np.zeros((5, 6)), {}, PATH, PATH + 0.1
)


def test_the_paths_are_drawn_from_their_first_pose_to_their_last() -> None:
    (panel,) = map_figure(SERIES).axes
    lines = {str(line.get_label()): line for line in panel.lines}
    np.testing.assert_array_equal(lines["true path"].get_xydata(), PATH[:, :2])
    estimate = next(line for name, line in lines.items() if name.startswith("estimated path"))
    np.testing.assert_array_equal(estimate.get_xydata(), PATH[:, :2] + 0.1)


def test_tracks_stand_in_the_truth_s_world() -> None:
    T_run = se3.make(np.eye(3), np.array([100.0, 0.0, 0.0]))
    tracks = tracks_at(110.0)  # 10 m ahead of the rig in the run's own world
    frame = compare_frame(objects_at(10.0), tracks, np.eye(4), T_run, ObjectCriteria())
    (panel,) = map_figure(SERIES, (frame,)).axes
    drawn = [np.asarray(line.get_xydata()).tolist() for line in panel.lines]
    assert drawn.count([[10.0, 3.0]]) == 2  # the object and its track
    assert {text.get_text() for text in panel.texts} == {"7"}  # no room for the track's, too


def test_tracks_look_like_tracks_and_not_like_the_rig() -> None:
    frames = [
        compare_frame(objects_at(25.0), tracks_at(x), np.eye(4), np.eye(4), ObjectCriteria())
        for x in (10.0, 20.0)
    ]
    (panel,) = map_figure(SERIES, frames).axes
    assert {text.get_text() for text in panel.texts} == {"7", "#0"}
    color_of = {str(line.get_label()): line.get_color() for line in panel.lines}
    estimate = next(name for name in color_of if name.startswith("estimated path"))
    assert len({color_of["tracks (#)"], color_of[estimate], color_of["true path"]}) == 3
