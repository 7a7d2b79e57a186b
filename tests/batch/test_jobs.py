"""A plan taken apart into jobs."""

from pathlib import Path

from ovmot.batch.jobs import render_jobs, run_jobs
from ovmot.batch.plan import read_plan

PLAN = """\
sequences:
  mh01: {data: data/mh01}
  street: {scene: traffic, size: [320, 140], duration_s: 2}
  walk: {features: walk.txt, n_features: 100}
settings:
  default: {}
  no_split: {split.enabled: false, tracker: {max_features: 100}, tracker.klt_levels: 3}
seeds: 3
"""


def plan_file(folder: Path, text: str) -> Path:
    path = folder / "plan.yaml"
    path.write_text(text)
    return path


def test_its_jobs(tmp_path: Path) -> None:
    plan = read_plan(plan_file(tmp_path, PLAN))
    runs = run_jobs(plan, tmp_path / "out", plan.seed_list)
    names = [run.name for run in runs]
    assert len(set(names)) == len(names) == 2 * (1 + 3 + 3)
    assert "mh01/default/0" in names and "mh01/default/1" not in names
    rendered = render_jobs(runs)
    assert [(job.seed, job.sequence.scene) for job in rendered] == [
        (s, "traffic") for s in range(3)
    ]
    assert len({run.identity for run in runs}) == len(runs)
