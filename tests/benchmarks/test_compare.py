"""`benchmarks/compare.py`: means of a batch side by side."""

from pathlib import Path

import yaml

from compare import ALL, METRICS, read_means, tables
from ovmot.batch.plan import read_plan

PLANS = Path(__file__).parents[2] / "benchmarks" / "plans"


def test_means_side_by_side(tmp_path: Path) -> None:
    """Sequences count once each, also where one has no such metric."""
    summary = tmp_path / "summary.csv"
    summary.write_text(
        "sequence,settings,metric,count,mean\n"
        "jam,default,ate_yaw_m,5,0.1\njam,default,mota,5,0.5\njam,few,ate_yaw_m,5,0.2\n"
        "empty,default,ate_yaw_m,1,0.3\nempty,few,ate_yaw_m,1,0.6\n"
    )
    jam, empty, both = tables(read_means(summary), ("ate_yaw_m", "mota"))
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in both.splitlines()]
    assert rows[0] == [ALL, "ate_yaw_m", "mota"]
    assert rows[2:] == [["default", "0.2", "0.5"], ["few", "0.4", "-"]]
    assert jam.startswith("| jam") and empty.startswith("| empty")


def test_every_plan_can_be_read() -> None:
    for plan in PLANS.glob("*.yaml"):
        read_plan(plan)
    shown = yaml.safe_load((PLANS / "features.yaml").read_text())["metrics"]
    assert tuple(shown) == METRICS
