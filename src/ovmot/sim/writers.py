"""The folder formats that a simulation can be written in."""

from collections.abc import Callable, Iterator
from pathlib import Path

from ovmot.datasets.euroc.writer import write_asl
from ovmot.datasets.four_seasons.writer import write_four_seasons
from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.kitti_raw.writer import write_kitti_extract, write_kitti_sync
from ovmot.datasets.tum_vi.writer import write_tum_vi
from ovmot.datasets.uzh_fpv.writer import write_uzh_fpv
from ovmot.datasets.viode.writer import write_viode
from ovmot.sim.simulation import Simulation

Writer = Callable[[Path, Simulation, int], Iterator[int]]
"""(folder, simulation, seed) -> the time in ns of each frame, when it is on disk."""

WRITERS: dict[str, Writer] = {
    "kaist": write_kaist,
    "asl": write_asl,
    "kitti_sync": write_kitti_sync,
    "kitti_extract": write_kitti_extract,
    "tum_vi": write_tum_vi,
    "viode": write_viode,
    "uzh_fpv": write_uzh_fpv,
    "4seasons": write_four_seasons,
}
