"""What OpenCV alone needs for a stereo KLT front end: the yardstick of `bench.py`.

    python benchmarks/floor.py FOLDER [--points 200]

Each stereo frame, in one thread: histogram equalisation and image pyramids of both images, FAST on
the left one, and pyramidal Lucas-Kanade forward only, from the last left image to this one and from
left to right. `cv2.calcOpticalFlowPyrLK` builds the pyramids of the images that it is given once
more; what two pairs of them take is measured beside it and taken off.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import ovmot
from ovmot.geometry.arrays import Image

Points = NDArray[np.float32]

N_POINTS = 200
STEPS = ("equalize", "pyramids", "FAST", "flow in time", "flow in stereo")
_REPEATED = "pyramids of the flow"
_WINDOW, _MAX_LEVEL = (15, 15), 5
_FAST_THRESHOLD = 20
_STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.01)
_COLUMNS, _ROWS = 10, 5  # of the cells over which the points are spread


@dataclass(frozen=True, slots=True)
class FloorTimes:
    """Mean milliseconds a frame: wall time of each of `STEPS` and of the pyramids built twice, and
    CPU time of the whole floor."""

    milliseconds: dict[str, float]
    repeated_ms: float
    cpu_ms: float

    @property
    def total_ms(self) -> float:
        """Wall time of the floor, ms a stereo frame."""
        return sum(self.milliseconds.values()) - self.repeated_ms


def measure_floor(pairs: Sequence[tuple[Image, Image]], n_points: int = N_POINTS) -> FloorTimes:
    """Time the loop over grey image pairs, left and right, that are in memory.

    The process is to be prepared by `ovmot.prepare_process`: one thread of OpenCV.
    """
    watch = _Watch()
    detector = cv2.FastFeatureDetector.create(_FAST_THRESHOLD, nonmaxSuppression=True)
    before: Image | None = None
    points: Points = np.empty((0, 1, 2), np.float32)
    for pair in pairs:
        with watch.step("equalize"):
            left, right = _equalized(pair[0]), _equalized(pair[1])
        with watch.step("pyramids"):
            for image in (left, right):
                cv2.buildOpticalFlowPyramid(image, _WINDOW, _MAX_LEVEL)
        with watch.step("FAST"):
            corners = detector.detect(left)
        if before is not None and len(points):
            with watch.step("flow in time"):
                _flow(before, left, points)
        before, points = left, spread_corners(corners, left.shape, n_points)
        if len(points):
            with watch.step("flow in stereo"):
                _flow(left, right, points)
        with watch.step(_REPEATED):
            for image in (left, right):
                cv2.buildOpticalFlowPyramid(image, _WINDOW, _MAX_LEVEL, withDerivatives=False)
    wall, cpu = watch.mean_ms()
    return FloorTimes(
        {step: wall.get(step, 0.0) for step in STEPS}, 2.0 * wall[_REPEATED],
        sum(cpu.get(step, 0.0) for step in STEPS) - 2.0 * cpu[_REPEATED],
    )  # fmt: skip


def spread_corners(
    corners: Sequence[cv2.KeyPoint], shape: tuple[int, ...], n_points: int
) -> Points:
    """The strongest corners (N, 1, 2), float32, as many of each cell of 10 x 5; the gaps that
    empty cells leave are filled by the strongest that are left."""
    at = np.array([corner.pt for corner in corners], np.float32).reshape(-1, 2)
    at = at[np.argsort([-corner.response for corner in corners], kind="stable")]
    cell = (at[:, 0] * _COLUMNS / shape[1]).astype(int) * _ROWS
    cell += (at[:, 1] * _ROWS / shape[0]).astype(int)
    rank = np.empty(len(at), dtype=int)
    for one in np.unique(cell):
        inside = np.flatnonzero(cell == one)
        rank[inside] = np.arange(len(inside))
    first = rank < -(-n_points // (_COLUMNS * _ROWS))
    return np.concatenate([at[first], at[~first]])[:n_points, None]


def _equalized(image: Image) -> Image:
    return np.asarray(cv2.equalizeHist(image), dtype=np.uint8)


def _flow(source: Image, target: Image, points: Points) -> None:
    cv2.calcOpticalFlowPyrLK(
        source, target, points, points.copy(), winSize=_WINDOW, maxLevel=_MAX_LEVEL,
        criteria=_STOP, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip


class _Watch:
    """Wall and CPU time of each time that a step was done, ms."""

    def __init__(self) -> None:
        self._spent: dict[str, list[tuple[float, float]]] = defaultdict(list)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        cpu, begin = time.thread_time(), time.perf_counter()
        yield
        wall, cpu = time.perf_counter() - begin, time.thread_time() - cpu
        self._spent[name].append((1e3 * wall, 1e3 * cpu))

    def mean_ms(self) -> tuple[dict[str, float], dict[str, float]]:
        means = {name: np.mean(spent, axis=0) for name, spent in self._spent.items()}
        wall, cpu = ({name: float(mean[k]) for name, mean in means.items()} for k in (0, 1))
        return wall, cpu


def main() -> None:
    """Print the floor of one sequence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--points", type=int, default=N_POINTS)
    arguments = parser.parse_args()
    ovmot.prepare_process()
    frames = (e for e in ovmot.open(arguments.folder) if isinstance(e, ovmot.StereoFrame))
    pairs = [frame.pair for frame in frames]
    times = measure_floor(pairs, arguments.points)
    listed = ", ".join(f"{step} {ms:.2f}" for step, ms in times.milliseconds.items())
    print(
        f"{arguments.folder.name}, {len(pairs)} pairs, {arguments.points} points: {listed},"
        f" pyramids of the flow -{times.repeated_ms:.2f}; floor {times.total_ms:.2f} ms a frame,"
        f" {times.cpu_ms:.2f} ms of CPU"
    )


if __name__ == "__main__":
    main()
