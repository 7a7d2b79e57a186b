"""One run: a sequence through the pipeline into an output folder."""

import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.masks import MaskSource, open_mask_files, open_masks, with_masks
from ovmot.datasets.pose_files import read_ego_poses
from ovmot.datasets.segmentation import SegmentationMasks
from ovmot.datasets.sequence import RecordedSequence
from ovmot.datasets.stream import events
from ovmot.errors import InputError, OvmotError
from ovmot.frontend.given_features import GivenFeatures
from ovmot.initialization.initializer import FilterInitializer
from ovmot.initialization.known_state import InitialSigmas, KnownStateInitializer
from ovmot.interfaces import FrontEnd, Initializer
from ovmot.odometry import STAGES, Odometry, noise_in_use
from ovmot.outputs.run_json import InputIdentity, RunSummary, write_run_json
from ovmot.outputs.run_writer import Output, RunContext, RunWriter, open_outputs
from ovmot.settings import Settings
from ovmot.sim.features import FeatureRecording
from ovmot.types import Event, ImuNoise, ImuSample, StereoFrame
from ovmot.vio.given_poses import GivenPoses, GivenPosesInitializer, imu_poses_from_cam0
from ovmot.vio.state import ImuState

_SAY_EVERY_NS = 1_000_000_000
_MOST_REFUSED = 0.5  # of the stereo matches: beyond, the calibration is to be doubted


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What to write, and where from the poses come if not from the filter."""

    out: Path
    ego_poses: Path | None = None
    save_points: bool = False
    video: bool = False
    force: bool = False
    first: int = 0
    last: int | None = None
    masks: Path | None = None
    more_outputs: tuple[Callable[[RunContext], Output], ...] = ()
    mask_files: tuple[Path | None, Path | None] = (None, None)


@dataclass(frozen=True, slots=True)
class _Source:
    """What a run reads and how it starts, whatever it comes from.

    `frontend` makes the front end, None the stereo tracker; `imu_noise` is for `run.json`;
    `frame_number` is that of each stamp (ns).
    """

    name: str
    rig: StereoRig
    stream: Generator[Event, None, None]
    start: Initializer
    frontend: FrontEnd | None
    imu_noise: ImuNoise | None
    identity: InputIdentity
    frame_number: Mapping[int, int]
    counts: Counter[str]
    warnings: Counter[str]


def run_sequence(
    sequence: RecordedSequence,
    settings: Settings,
    options: RunOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> RunSummary:
    """Run, write everything into `options.out`, and say how it went.

    `on_frame` is called with the number of frames read, `on_wait` once a second of the data while
    there is no start, with the reason. An error or Ctrl-C in the middle leaves whole rows and a
    `run.json` that says so, and is raised again.
    """
    stream = events(sequence, first=options.first, last=options.last)
    for masks in _masks(sequence, settings, options):
        stream = with_masks(stream, masks)
    source = _Source(
        name=str(sequence.root),
        rig=sequence.rig,
        stream=stream,
        start=make_initializer(sequence, settings, options.ego_poses),
        frontend=None,
        imu_noise=None if sequence.imu is None else imu_noise(sequence, settings),
        identity=_identity(sequence),
        frame_number=dict(
            zip(sequence.frame_ns.tolist(), sequence.frame_number.tolist(), strict=True)
        ),
        counts=Counter(sequence.counts),
        warnings=Counter(sequence.warnings),
    )
    return _run(source, settings, options, on_frame, on_wait)


def _masks(
    sequence: RecordedSequence, settings: Settings, options: RunOptions
) -> Iterator[MaskSource]:
    """The masks of a folder, of two files, and of the data's segmentation."""
    if options.masks is not None:
        yield open_masks(options.masks, sequence.rig)
    if any(options.mask_files):
        yield open_mask_files(options.mask_files, sequence.rig)
    ids = settings.masks.segmentation_ids
    if ids and sequence.segmentation is None:
        remedy = "leave out masks.segmentation_ids"
        raise InputError.at(sequence.root, "has no segmentation pictures", remedy)
    if ids and sequence.segmentation is not None:
        yield SegmentationMasks.make(sequence.segmentation, ids, sequence.rig)


def run_features(
    recording: FeatureRecording,
    settings: Settings,
    options: RunOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    initial_sigmas: InitialSigmas = InitialSigmas(),  # noqa: B008 - frozen
    initial_rig: StereoRig | None = None,
) -> RunSummary:
    """Run a feature-level simulation, started at its truth; as `run_sequence` otherwise.

    `initial_sigmas` are the prior standard deviations of that start, `initial_rig` the
    calibration that it is given in place of the true one. Raises `InputError` for what
    needs images or frame numbers: an overlay, poses from a file, a first or last frame.
    """
    if options.video or options.ego_poses is not None or options.first or options.last is not None:
        raise InputError("a feature-level simulation has no images and runs from end to end")
    simulation = recording.simulation
    rig = initial_rig or simulation.rig
    source = _Source(
        name="feature simulation",
        rig=rig,
        stream=recording.events(),
        start=known_state_initializer(recording, settings, initial_sigmas, rig),
        frontend=GivenFeatures(rig, settings.tracker, settings.epipolar),
        imu_noise=simulation.imu.noise,
        identity=InputIdentity(
            path="",
            kind="features",
            n_frames=len(simulation.camera_ns),
            n_imu_samples=len(recording.imu.data),
            first_timestamp_ns=int(simulation.camera_ns[0]),
            last_timestamp_ns=int(simulation.camera_ns[-1]),
        ),
        frame_number={int(t): i for i, t in enumerate(simulation.camera_ns)},
        counts=Counter(seed=recording.seed),
        warnings=Counter(),
    )
    return _run(source, settings, options, on_frame)


def _run(
    source: _Source,
    settings: Settings,
    options: RunOptions,
    on_frame: Callable[[int], None],
    on_wait: Callable[[str], None] = lambda _: None,
) -> RunSummary:
    counts = Counter(source.counts)
    began = time.perf_counter()
    ended = "finished"
    failure: BaseException | None = None
    odometry = Odometry(
        source.rig,
        source.imu_noise,
        settings,
        initializer=source.start,
        frontend=source.frontend,
    )
    writer = open_outputs(
        options.out, rig=source.rig, save_points=options.save_points, video=options.video,
        force=options.force, stages=STAGES, calibration=settings.calibration.any,
        frame_number=source.frame_number if settings.objects.enabled else None,
        more=options.more_outputs,
    )  # fmt: skip
    try:
        with writer, closing(source.stream):
            stream = _with_pose(source.stream, source.start, counts)
            _feed_all(_saying(stream, odometry, on_wait), odometry, writer, counts, on_frame)
            if writer.frames_written == 0:
                why = odometry.not_started_because or "no frame was seen"
                raise OvmotError(f"{source.name}: never started: {why}")
    except KeyboardInterrupt as stop:
        ended, failure = "interrupted", stop
        raise
    except Exception as error:
        ended, failure = f"failed: {error}", error
        raise
    finally:
        odometry.finish()
        counts["frames_written"] = writer.frames_written
        counts["frames_never_covered_by_imu"] = odometry.dropped
        counts.update(odometry.counts)
        summary = RunSummary(
            settings=settings,
            options=_options(options, source.start),
            imu_noise=source.imu_noise,
            source=source.identity,
            counts=counts,
            warnings=_warnings(source.warnings, options, settings, counts),
            not_started_because=odometry.not_started_because,
            ended=ended,
            wall_seconds=time.perf_counter() - began,
        )
        try:
            write_run_json(options.out, summary)
        except OvmotError as second:
            if failure is None:
                raise
            failure.add_note(str(second))  # the first error is the one to report
    return summary


def _warnings(
    noticed: Counter[str], options: RunOptions, settings: Settings, counts: Counter[str]
) -> Counter[str]:
    """What the reader noticed, and what happened to frames on the way."""
    warnings = Counter(noticed)
    if counts["frames_without_pose"]:
        text = f"{options.ego_poses}: frames for which it has no pose: left out"
        warnings[text] += counts["frames_without_pose"]
    if counts["frames_before_start"]:
        warnings["frames before the start, without a pose"] += counts["frames_before_start"]
    if counts["frames_never_covered_by_imu"]:
        text = "frames that the IMU never covered: without a pose"
        warnings[text] += counts["frames_never_covered_by_imu"]
    unsure = counts["frames_degraded"] + counts["frames_lost"]
    if unsure:
        warnings["frames whose pose rests on the IMU alone (`health` in state.csv)"] += unsure
    if counts["resets"]:
        text = "new starts because the motion was lost: the position may jump there"
        warnings[text] += counts["resets"]
    refused, tested = counts["stereo_matches_refused"], counts["stereo_matches"]
    if refused > _MOST_REFUSED * tested:
        text = f"stereo matches refused by the extrinsics, of {tested}: try 'ovmot doctor'"
        warnings[text] += refused
    if counts["frames_without_stereo"] and settings.tracker.cameras == "stereo":
        text = "frames without a stereo match: no scale from them, and nothing seen to move"
        warnings[text] += counts["frames_without_stereo"]
    return warnings


def _options(options: RunOptions, start: Initializer) -> dict[str, str | int | None]:
    """What the run was asked for, beside its settings."""
    return {
        "ego": "poses" if isinstance(start, GivenPosesInitializer) else "filter",
        "start": "truth" if isinstance(start, KnownStateInitializer) else "found",
        "ego_poses": None if options.ego_poses is None else str(options.ego_poses.resolve()),
        "masks": None if options.masks is None else str(options.masks.resolve()),
        "mask_files": ", ".join(str(file) for file in options.mask_files if file) or None,
        "first": options.first,
        "last": options.last,
    }


def make_initializer(
    sequence: RecordedSequence, settings: Settings, ego_poses: Path | None
) -> Initializer:
    """Where the ego motion comes from: a pose file if one is given, else the filter."""
    if ego_poses is not None:
        ego = read_ego_poses(ego_poses, sequence.frame_ns)
        T = ego.T_world_body[ego.known]
        if ego.body == "cam0":
            T = imu_poses_from_cam0(T, sequence.rig)
        stamps = ego.timestamp_ns[ego.known]
        return GivenPosesInitializer(GivenPoses(stamps, T, sequence.rig, settings.given_ego))
    if sequence.imu is None:
        raise InputError.at(
            sequence.root,
            "has no IMU",
            "give the ego motion by --ego poses FILE (TUM, EuRoC or KITTI form)",
        )
    return FilterInitializer(sequence.rig, imu_noise(sequence, settings), settings)


def known_state_initializer(
    recording: FeatureRecording, settings: Settings, sigmas: InitialSigmas, rig: StereoRig
) -> KnownStateInitializer:
    """The filter's start at the truth of a simulation's first frame, exact biases included.

    A rig whose time offset is wrong puts that frame at another instant: the truth is that of then.
    """
    simulation, truth = recording.simulation, recording.truth()
    first_ns = int(truth.timestamp_ns[0])
    then_ns = first_ns + round(1e9 * (rig.time_offset_s - simulation.rig.time_offset_s))
    T, velocity = simulation.path.pose(then_ns), simulation.path.velocity(then_ns)
    state = ImuState(T[:3, :3], T[:3, 3], velocity, truth.gyro_bias[0], truth.accel_bias[0])
    return KnownStateInitializer(first_ns, state, sigmas, rig, simulation.imu.noise, settings)


def imu_noise(sequence: RecordedSequence, settings: Settings) -> ImuNoise:
    """Noise densities for a sequence, see `noise_in_use`."""
    return noise_in_use(sequence.imu_noise, settings.imu)


def _feed_all(
    stream: Iterable[Event],
    odometry: Odometry,
    writer: RunWriter,
    counts: Counter[str],
    on_frame: Callable[[int], None],
) -> None:
    for event in stream:
        if not isinstance(event, ImuSample):
            counts["frames_read"] += 1
            on_frame(counts["frames_read"] + counts["frames_without_pose"])
        else:
            counts["imu_samples_read"] += 1
        for result in odometry.add(event):
            writer.write(result)
            counts["stereo_matches"] += len(result.matches.accepted)
            counts["stereo_matches_refused"] += int(np.count_nonzero(~result.matches.accepted))
            if isinstance(result.frame, StereoFrame) and not result.matches.accepted.any():
                counts["frames_without_stereo"] += 1


def _saying(
    stream: Iterable[Event], odometry: Odometry, on_wait: Callable[[str], None]
) -> Iterator[Event]:
    """The events; once a second of the data without a start, why there is none is said."""
    said_ns: int | None = None
    for event in stream:
        yield event
        if isinstance(event, ImuSample):
            continue
        if odometry.started:
            said_ns = None
        elif said_ns is None:
            said_ns = event.timestamp_ns  # a start in the first second needs no words
        elif event.timestamp_ns - said_ns >= _SAY_EVERY_NS:
            said_ns = event.timestamp_ns
            why = odometry.not_started_because or "no frame is covered by the IMU"
            on_wait(f"no start at frame {event.timestamp_ns} ns: {why}")


def _with_pose(
    stream: Iterable[Event], start: Initializer, counts: Counter[str]
) -> Iterator[Event]:
    """The events, without the frames for which a pose file has no pose; those are counted."""
    if not isinstance(start, GivenPosesInitializer):
        yield from stream
        return
    counts["frames_without_pose"] = 0
    posed = set(start.source.pose_ns.tolist())
    for event in stream:
        if isinstance(event, ImuSample) or event.timestamp_ns in posed:
            yield event
        else:
            counts["frames_without_pose"] += 1


def _identity(sequence: RecordedSequence) -> InputIdentity:
    stamps = sequence.frame_ns
    return InputIdentity(
        path=str(sequence.root.resolve()),
        kind=sequence.kind,
        n_frames=len(sequence),
        n_imu_samples=0 if sequence.imu is None else len(sequence.imu),
        first_timestamp_ns=int(np.min(stamps)) if len(stamps) else None,
        last_timestamp_ns=int(np.max(stamps)) if len(stamps) else None,
    )
