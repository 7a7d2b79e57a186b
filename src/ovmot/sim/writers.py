"""The folder formats that a simulation can be written in."""

from collections.abc import Callable, Iterator
from pathlib import Path

from ovmot.sim.asl_writer import write_asl
from ovmot.sim.simulation import Simulation
from ovmot.sim.writer import write_kaist

Writer = Callable[[Path, Simulation, int], Iterator[int]]
"""(folder, simulation, seed) -> the time in ns of each frame, when it is on disk."""

WRITERS: dict[str, Writer] = {"kaist": write_kaist, "asl": write_asl}
