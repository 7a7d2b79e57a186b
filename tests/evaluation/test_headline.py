"""The metrics that are shown first."""

from ovmot.evaluation.headline import HEADLINE_ROWS, HEADLINES, NOTES, headline


def test_eight_lines_in_a_fixed_order_with_a_value() -> None:
    every = dict.fromkeys(HEADLINES, 1.0)
    shown = headline(every)
    assert len(shown) == HEADLINE_ROWS == 8
    assert shown[:3] == ["ate_yaw_m", "ate_percent", "ate_yaw_deg"]
    assert "confirmed_tracks_per_min" not in shown
    assert headline({"ate_yaw_m": 1.0, "idf1": None, "rpe_1s_m": 0.1}) == ["ate_yaw_m", "rpe_1s_m"]


def test_where_nothing_is_known_of_objects_confirmed_tracks_are_shown() -> None:
    shown = headline({"ate_yaw_m": 1.0, "confirmed_tracks_per_min": 0.0})
    assert shown == ["ate_yaw_m", "confirmed_tracks_per_min"]


def test_no_metric_has_two_explanations() -> None:
    assert not HEADLINES.keys() & NOTES.keys()
