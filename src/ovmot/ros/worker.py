"""The thread between a node's callbacks and its messages; it knows no version of ROS."""

import threading
import time
from collections.abc import Callable, Iterable

from ovmot.cameras.calibration import Calibration
from ovmot.config import Settings
from ovmot.msckf.start import FilterStart
from ovmot.pipeline import Pipeline
from ovmot.ros.intake import Intake
from ovmot.ros.session import Session, Sink
from ovmot.ros.watch import Watch
from ovmot.run import noise_in_use


class Worker:
    """Takes from `intake`, which callbacks fill, and sends to `sink`, in a thread of its own."""

    def __init__(
        self, settings: Settings, calibration: Calibration, sink: Sink, say: Callable[[str], None]
    ) -> None:
        rig, live = calibration.rig, settings.live
        noise = noise_in_use(calibration.imu_noise, settings)
        self.intake = Intake(live, rig.time_offset_s)
        self._session = Session(
            self.intake,
            lambda: Pipeline(rig, settings, FilterStart(rig, noise, settings)),
            rig,
            live,
            sink,
            say,
        )
        self._topics = {"left": live.left, "right": live.right, "imu": live.imu}
        self._watch = Watch.begin(time.monotonic())
        self._failure: BaseException | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._work, name="ovmot-worker", daemon=True)
        self._thread.start()

    def look(self) -> Iterable[str]:
        """What is to be said of silent or lost inputs; raises what ended the thread."""
        if self._failure is not None:
            raise self._failure
        counts, apart_s = self.intake.counts(), self.intake.pair_distance_s
        self._watch, lines = self._watch.look(time.monotonic(), counts, self._topics, apart_s)
        return lines

    def close(self) -> str:
        """End the thread; one line on what became of the frames and how late they were."""
        self._ending.set()
        self._thread.join(timeout=5.0)
        self._session.close()
        counts, done = self.intake.counts(), self._session.counts
        text = (
            f"{counts['pairs']} frames, {done['results']} results, {counts['dropped']} dropped, "
            f"{done['before_start']} before the start, {done['refused']} refused, "
            f"{done['restarts']} restarts"
        )
        half, most = self._session.latency_ms(50), self._session.latency_ms(95)
        return text if half is None else f"{text}; latency p50 {half:.0f} ms, p95 {most:.0f} ms"

    def _work(self) -> None:
        try:
            while not self._ending.is_set():
                self._session.work_once()
        except BaseException as error:
            self._failure = error
