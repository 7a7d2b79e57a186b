"""What the runs add up to."""

import pytest

from ovmot.batch.summary import BatchSummary, consistency_of, summary_tables


@pytest.mark.parametrize(
    ("nees", "verdict"), [(1.2, "too cautious"), (4.6, "inside"), (7.0, "overconfident")]
)
def test_the_velocity_of_objects_is_judged_by_a_factor_of_two(nees: float, verdict: str) -> None:
    values = (nees - 0.2, nees + 0.2, None)
    runs: list[dict[str, float | None]] = [{"object_velocity_nees": value} for value in values]
    (found,) = consistency_of({("street", "default"): runs})
    assert (found.runs, found.low, found.high) == (2, 1.5, 6.0)
    assert found.mean == pytest.approx(nees)
    _, table = summary_tables(BatchSummary((), (found,), 2, {}), None)
    assert list(table.columns[-1].cells) == [verdict]
