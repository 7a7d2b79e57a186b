"""The thread between a node's callbacks and its messages, for either version of ROS."""

import gc
import threading
import time
from collections.abc import Callable, Mapping

from ovmot import Odometry
from ovmot.datasets.calibration import Calibration
from ovmot.ros.inputs import InputTopic
from ovmot.ros.intake import Intake
from ovmot.ros.session import Session, Sink
from ovmot.ros.watch import Line, Sight, Watch
from ovmot.settings import Settings
from ovmot.warmup.parts import PARTS


def load_kernels() -> None:
    """Load the compiled code of the later stages, before the first frame has to wait for it.

    Its objects stay as long as the process: the garbage collector need not go through them again.
    """
    for name in ("filter", "objects"):
        PARTS[name]()
    gc.collect()
    gc.freeze()


class Worker:
    """Takes from `intake`, which callbacks fill, and sends to `sink`, in a thread of its own."""

    def __init__(
        self,
        settings: Settings,
        calibration: Calibration,
        topics: Mapping[str, InputTopic],
        sink: Sink,
        say: Callable[[Line], None],
    ) -> None:
        rig, live = calibration.rig, settings.live
        self.intake = Intake(live, rig.time_offset_s)
        self._session = Session(
            self.intake,
            lambda: Odometry(rig, calibration.imu_noise, settings, threads=2),
            rig,
            live,
            sink,
            say,
        )
        self._watch = Watch.begin(topics, time.monotonic())
        self._failure: BaseException | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, name="ovmot-worker", daemon=True)
        self._thread.start()

    def look(self, published: Mapping[str, str] | None) -> list[Line]:
        """What is to be said of silent or lost inputs; raises what ended the thread.

        `published`: the types of all topics that anybody publishes, None where not known.
        """
        if self._failure is not None:
            raise self._failure
        intake = self.intake
        sight = Sight(time.monotonic(), intake.counts(), intake.pair_distance_s, published)
        self._watch, lines = self._watch.look(sight)
        return lines

    def close(self) -> str:
        """End the thread; returns one line with the counts of frames and their latency."""
        self._ending.set()
        self._thread.join(timeout=5.0)
        self._session.close()
        counts, done = self.intake.counts(), self._session.counts
        text = (
            f"{counts['pairs']} frames, {done['results']} results, {counts['dropped']} dropped, "
            f"{done['before_start']} before the start, {done['refused']} refused, "
            f"{done['restarts']} restarts"
        )
        spoilt = done["imu_spikes"] + done["imu_saturated"]
        text += f", {spoilt} spoilt IMU samples left out" if spoilt else ""
        half, most = self._session.latency_ms(50), self._session.latency_ms(95)
        return text if half is None else f"{text}; latency p50 {half:.0f} ms, p95 {most:.0f} ms"

    def _work(self) -> None:
        try:
            while not self._ending.is_set():
                self._session.work_once()
        except BaseException as error:
            self._failure = error
