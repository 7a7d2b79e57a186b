"""What the benchmarks run on: sequences decoded into memory, and streets simulated once."""

import hashlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import ovmot
from ovmot.geometry.arrays import Image

DEFAULT_SEQUENCES = ("euroc_mh01", "street_traffic")
TRAFFIC_SIZE = (1280, 560)
_REPOSITORY = Path(__file__).resolve().parents[1]
_SIMULATOR = _REPOSITORY / "src" / "ovmot" / "sim"
_KEY_LENGTH = 12


@dataclass(frozen=True, slots=True)
class Recording:
    """A sequence whose events are in memory; `source` is its folder."""

    name: str
    source: Path
    rig: ovmot.StereoRig
    imu_noise: ovmot.ImuNoise | None
    events: tuple[ovmot.Event, ...]

    @property
    def pairs(self) -> list[tuple[Image, Image]]:
        """The grey images of all frames, left and right."""
        frames = (event for event in self.events if isinstance(event, ovmot.StereoFrame))
        return [frame.pair for frame in frames]

    @property
    def image_bytes(self) -> int:
        """Memory that the images take."""
        return sum(left.nbytes + right.nbytes for left, right in self.pairs)

    @property
    def size(self) -> str:
        """Width and height of the images."""
        return f"{self.rig.cam0.width}x{self.rig.cam0.height}"


def in_memory(folder: Path) -> Recording:
    """Decode a sequence. Raises `InputError` where it cannot be read."""
    sequence = ovmot.open(folder)
    name = folder.resolve().name
    return Recording(name, folder, sequence.rig, sequence.imu_noise, tuple(sequence))


def data_root() -> Path:
    """Folder of the test data: `$OVMOT_DATA`, else `../shared/data`."""
    return Path(os.environ.get("OVMOT_DATA", _REPOSITORY.parent / "shared" / "data"))


def default_folders(cache: Path) -> list[Path]:
    """The real sequences that are there, of `$OVMOT_DATA` or `../shared/data`, and a street with
    traffic."""
    data = data_root()
    real = [data / name for name in DEFAULT_SEQUENCES if (data / name).is_dir()]
    return [*real, simulated_street(cache, "traffic", TRAFFIC_SIZE)]


def default_cache() -> Path:
    """`$XDG_CACHE_HOME/ovmot/benchmarks`, else `~/.cache/ovmot/benchmarks`."""
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else Path.home() / ".cache") / "ovmot" / "benchmarks"


def simulated_street(
    cache: Path, scene: str, size: tuple[int, int], duration_s: float | None = None
) -> Path:
    """The folder of a simulated scene, seed 0; it is rendered if the cache does not hold it.

    `scene` is one of the catalog or a YAML file. The folder's name has a hash of the scene and of
    the simulator's source: another simulator, another folder.
    """
    key = hashlib.sha256(repr((size, duration_s)).encode())
    if Path(scene).is_file():
        key.update(Path(scene).read_bytes())
    for source in sorted((*_SIMULATOR.rglob("*.py"), *_SIMULATOR.rglob("*.yaml"))):
        key.update(source.read_bytes())
    name = f"{Path(scene).stem}_{size[0]}x{size[1]}"
    folder = cache / key.hexdigest()[:_KEY_LENGTH] / name
    if not folder.is_dir():
        unfinished = folder.with_name(f"{name}.{os.getpid()}.part")
        shutil.rmtree(unfinished, ignore_errors=True)
        try:
            ovmot.simulate(scene, size=size, duration_s=duration_s).write(unfinished)
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return folder
