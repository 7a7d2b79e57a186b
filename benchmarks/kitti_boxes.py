"""Share of dynamic points that lie in the labelled boxes of moving vehicles, on KITTI tracking.

    python benchmarks/kitti_boxes.py LABELS.txt POINTS.csv TRACK_ID [TRACK_ID ...]

LABELS is the sequence's `label_02` file, POINTS a run's `points.csv`, the ids those of labelled
vehicles that move. Points of frames without any such box count as outside.
"""

import csv
import sys
from pathlib import Path

MARGIN_PX = 3.0
FRAME_NS = 100_000_000


def moving_boxes(labels: Path, ids: set[int]) -> dict[int, list[tuple[float, ...]]]:
    """Boxes (u_min, v_min, u_max, v_max) of the given ids by frame number."""
    boxes: dict[int, list[tuple[float, ...]]] = {}
    for line in labels.read_text().splitlines():
        fields = line.split()
        if int(fields[1]) in ids:
            boxes.setdefault(int(fields[0]), []).append(tuple(map(float, fields[6:10])))
    return boxes


def inside(u: float, v: float, box: tuple[float, ...]) -> bool:
    """Is a pixel in a box, give or take the margin?"""
    u_min, v_min, u_max, v_max = box
    return (
        u_min - MARGIN_PX <= u <= u_max + MARGIN_PX and v_min - MARGIN_PX <= v <= v_max + MARGIN_PX
    )


def main(labels: Path, points: Path, ids: set[int]) -> None:
    """Count and print."""
    boxes = moving_boxes(labels, ids)
    counts = {(label, within): 0 for label in ("dynamic", "static") for within in (True, False)}
    with points.open() as rows:
        for row in csv.DictReader(rows):
            if row["label"] not in ("dynamic", "static"):
                continue
            frame = int(row["timestamp_ns"]) // FRAME_NS
            u, v = float(row["u"]), float(row["v"])
            within = any(inside(u, v, box) for box in boxes.get(frame, []))
            counts[row["label"], within] += 1
    dynamic = counts["dynamic", True] + counts["dynamic", False]
    share = counts["dynamic", True] / max(dynamic, 1)
    print(f"dynamic points: {dynamic}, in boxes of moving vehicles: {100 * share:.1f} %")
    print(f"static points in those boxes: {counts['static', True]}, elsewhere:"
          f" {counts['static', False]}")  # fmt: skip


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]), {int(text) for text in sys.argv[3:]})
