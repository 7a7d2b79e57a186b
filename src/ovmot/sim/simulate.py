"""A simulated sequence as the public API gives it: events to feed, or a folder to write."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.registry import WRITERS
from ovmot.datasets.stream import samples
from ovmot.datasets.writing import SequenceToWrite
from ovmot.errors import InputError
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.sim.recording import record
from ovmot.sim.scene_file import load_scene
from ovmot.sim.scenes import make_simulation
from ovmot.text_files import StrPath
from ovmot.types import Event, ImuNoise


@dataclass(frozen=True, slots=True)
class SimulatedSequence:
    """A rendered street with exact truth; iterated over, it gives IMU samples and stereo frames.

    Frames are rendered when they are asked for; each pass gives the same ones.
    """

    content: SequenceToWrite

    @property
    def rig(self) -> StereoRig:
        """The true calibration."""
        return self.content.rig

    @property
    def imu_noise(self) -> ImuNoise:
        """The true noise densities of the IMU."""
        return self.content.imu.noise

    @property
    def frame_ns(self) -> IntArray:
        """Stamps (M,) of the stereo frames, ns, rising."""
        return self.content.camera_ns

    @property
    def T_world_imu(self) -> FloatArray:
        """True poses (M, 4, 4) of the IMU at the frames, metres, z up."""
        return self.content.path.pose(self.content.camera_ns)

    def __len__(self) -> int:
        return len(self.content.camera_ns)

    def __iter__(self) -> Iterator[Event]:
        imu, begin = self.content.imu.data, 0
        for seen in self.content.frames(self.rig):
            stamp = seen.frame.timestamp_ns
            end = int(np.searchsorted(imu.timestamp_ns, stamp, side="right"))
            yield from samples(imu, begin, end)
            begin = end
            yield seen.frame
        yield from samples(imu, begin, len(imu))

    def write(
        self,
        folder: StrPath,
        format: str = "kaist",
        on_frame: Callable[[int], None] = lambda _: None,
    ) -> None:
        """Write a folder of a data set's format, with the truth in `truth/`.

        `format` is a key of `WRITERS`; `on_frame` is called with the number of frames on disk.
        Raises `InputError` for an unknown format, one that cannot hold the rig, or a folder that is
        not empty.
        """
        if format not in WRITERS:
            raise InputError(f"format {format}: unknown; choose one of {', '.join(WRITERS)}")
        for done, _ in enumerate(WRITERS[format](Path(folder), self.content), start=1):
            on_frame(done)


def simulate(
    scene: StrPath = "traffic",
    *,
    seed: int = 0,
    path: StrPath | None = None,
    size: tuple[int, int] | None = None,
    rate_hz: float | None = None,
    duration_s: float | None = None,
    rig: StereoRig | None = None,
) -> SimulatedSequence:
    """Simulate a street with traffic, seen by a stereo rig with an IMU.

    Parameters
    ----------
    scene
        A scene of the catalog (a key of `SCENES`) or a YAML file of one (docs/simulator.md).
    seed
        Another seed, another street; the same one gives the same sequence.
    path
        How the rig moves: None as the scene has it, "stand", "walk", "drive", or a TUM file.
    size
        Width and height of the images, pixels; else the scene's.
    rate_hz, duration_s
        Stereo frames a second, and length of the sequence; else the scene's.
    rig
        Another rig than the scene's, on the same IMU (in a car: x ahead, y left, z up), with its
        own image size.

    Raises
    ------
    InputError
        For an unknown scene, a broken file, or values out of range.
    """
    simulation = make_simulation(
        load_scene(str(scene)), seed=seed, path=None if path is None else str(path), size=size,
        rate_hz=rate_hz, duration_s=duration_s,
    )  # fmt: skip
    if rig is not None:
        simulation = replace(simulation, rig=rig)
    return SimulatedSequence(record(simulation, seed))
