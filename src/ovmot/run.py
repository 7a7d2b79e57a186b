"""A run: a sequence through the odometry into an output folder."""

import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from ovmot.datasets.corrections import corrected
from ovmot.datasets.instance_masks import InstanceMasks
from ovmot.datasets.kalibr import CHAIN_FILE, write_chain
from ovmot.datasets.masks import (
    RIG_MASKS,
    MaskSource,
    open_mask_files,
    open_masks,
    with_masks,
)
from ovmot.datasets.pose_files import read_ego_poses
from ovmot.datasets.presets import Preset
from ovmot.datasets.sequence import RecordedSequence
from ovmot.datasets.usable_events import usable_events
from ovmot.doctor.during_run import MOST_REFUSED, RunCheck
from ovmot.errors import InputError, OvmotError, is_interrupt
from ovmot.odometry import NO_OBJECTS, STAGES, Odometry, noise_in_use, settings_in_use
from ovmot.outputs.rig_masks import write_rig_masks
from ovmot.outputs.run_json import (
    RUNNING,
    InputIdentity,
    RunSummary,
    reserve_run_json,
    write_run_json,
)
from ovmot.outputs.run_writer import Output, RunContext, RunWriter, open_outputs
from ovmot.outputs.views import View
from ovmot.runtime import HeldInterrupts
from ovmot.settings import Settings
from ovmot.text_files import StrPath
from ovmot.types import Event, FrameResult, ImuNoise, ImuSample, Picture, StereoFrame
from ovmot.vio.given_poses import GivenPoses, GivenPosesInitializer, imu_poses_from_cam0

_SAY_EVERY_NS = 1_000_000_000
_UPDATE_EVERY_S = 5.0  # of the clock on the wall


_LEFT_OUT = {
    "frames_out_of_order": "frames whose stamp does not follow the one before: left out",
    "imu_out_of_order": "IMU samples whose stamp does not follow the one before: left out",
    "clock_set_back": "times the clock was set back: started again there",
    "imu_spikes": "IMU samples far from their neighbours: left out as spikes",
    "imu_saturated": "IMU samples at the end of the sensor's range: left out",
}
"""The counts of `usable_events`, and what a run says of them."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Where a run writes, what beside its tables, and which part of the sequence it reads.

    Parameters
    ----------
    out
        The output folder, made if missing.
    ego_poses
        A pose file in place of the filter: TUM, EuRoC or KITTI form.
    save_points, video
        Write `points.csv` and `stereo.csv`; write `overlay.mp4`.
    view
        What the video shows: `objects`, `stereo`, `dynamic` or `all`.
    preview
        Keep small pictures of the run in `preview.npz`, for its report.
    force
        Replace the run that the folder holds.
    first, last
        The first and the last frame (included), counted from 0; None for the end.
    masks, mask_files
        A folder of masks, or one image for each camera: nothing is taken from pixels other than 0.
    more_outputs
        Factories of further outputs; each result is given to them too.
    threads
        Of the odometry, 1 or 2, beside the one that reads and writes; the results are the same.
    doctor_options
        What `ovmot doctor` needs, beside the data, to read the same: hints repeat it.
    """

    out: StrPath
    ego_poses: StrPath | None = None
    save_points: bool = False
    video: bool = False
    force: bool = False
    first: int = 0
    last: int | None = None
    masks: StrPath | None = None
    more_outputs: tuple[Callable[[RunContext], Output], ...] = ()
    mask_files: tuple[StrPath | None, StrPath | None] = (None, None)
    threads: int = 1
    view: View = "objects"
    preview: bool = False
    doctor_options: str = ""


@dataclass(frozen=True, slots=True)
class RunInput:
    """What a run reads, wherever it comes from, and the odometry that it is given to.

    `name` stands before messages. `ego` and `start` say for `run.json` where the poses come from
    and how they begin; `imu_noise` is for `run.json` too, None without an IMU. `frame_number` is
    that of each stamp (ns). `counts` and `warnings` are those of the reader; the stream may add to
    `counts`, the run to both. `preset` is that of the data, `check` what looks at it while it runs.
    """

    name: str
    odometry: Odometry
    stream: Generator[Event, None, None]
    imu_noise: ImuNoise | None
    identity: InputIdentity
    frame_number: Mapping[int, int]
    counts: Counter[str]
    warnings: Counter[str]
    ego: Literal["filter", "poses"] = "filter"
    start: Literal["found", "truth"] = "found"
    preset: Preset | None = None
    check: RunCheck | None = None


def run_sequence(
    sequence: RecordedSequence,
    settings: Settings,
    options: RunOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> RunSummary:
    """Run, write everything into `options.out`, and say how it went.

    `on_frame` is called with the number of frames read, `on_wait` once a second of the data while
    there is no initial state, with the reason, and with what is found to be wrong with the data in
    its first seconds. Ctrl-C takes effect between two events. It and an
    error in the middle leave whole rows and a `run.json` that says so, and are raised again. Raises
    `InputError` for options that do not fit the sequence or the folder, `OvmotError` where the run
    fails.
    """
    sequence = corrected(sequence, settings.recording)
    counts, wanted = Counter(sequence.counts), settings.objects.enabled
    settings = settings_in_use(settings, sequence.rig)
    no_objects = [NO_OBJECTS] if wanted and not settings.objects.enabled else []
    stream = sequence.events(options.first, options.last)
    for masks in _masks(sequence, settings, options):
        stream = with_masks(stream, masks)
    poses: GivenPosesInitializer | None = None
    if options.ego_poses is not None:
        poses = poses_from_file(options.ego_poses, sequence, settings)
        stream = _with_pose(stream, poses, counts)
    elif sequence.imu is None:
        raise InputError.at(
            sequence.root,
            "has no IMU",
            "give the ego motion by --ego poses FILE (TUM, EuRoC or KITTI form)",
        )
    source = RunInput(
        name=str(sequence.root),
        odometry=Odometry(
            sequence.rig, sequence.imu_noise, settings, initializer=poses, threads=options.threads
        ),
        stream=stream,
        imu_noise=None if sequence.imu is None else noise_in_use(sequence.imu_noise, settings.imu),
        identity=_identity(sequence),
        frame_number=dict(
            zip(sequence.frame_ns.tolist(), sequence.frame_number.tolist(), strict=True)
        ),
        counts=counts,
        warnings=Counter([*sequence.warnings, *no_objects]),
        ego="filter" if poses is None else "poses",
        preset=sequence.preset,
        check=RunCheck(sequence, settings, options.doctor_options) if poses is None else None,
    )
    return run_into_folder(source, settings, options, on_frame, on_wait)


def poses_from_file(
    path: StrPath, sequence: RecordedSequence, settings: Settings | None = None
) -> GivenPosesInitializer:
    """An initializer for `Odometry` that takes the rig's poses from a file, in place of the filter.

    TUM and EuRoC files hold poses of the IMU by time, KITTI files (12 columns) those of the left
    camera, one row a frame. `settings.given_ego` says how far they are trusted. Frames without a
    pose must not be given to the odometry; the initializer's `ego.pose_ns` (M,) are the stamps of
    those that have one. Raises `InputError` with file and row.
    """
    ego = read_ego_poses(Path(path), sequence.frame_ns)
    T = ego.T_world_body[ego.known]
    if ego.body == "cam0":
        T = imu_poses_from_cam0(T, sequence.rig)
    trust = (settings or Settings()).given_ego
    return GivenPosesInitializer(
        GivenPoses(ego.timestamp_ns[ego.known], T, sequence.rig, trust)
    )  # fmt: skip


def run_into_folder(
    source: RunInput,
    settings: Settings,
    options: RunOptions,
    on_frame: Callable[[int], None] = lambda _: None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> RunSummary:
    """Give the stream to the odometry and its results to the files; see `run_sequence`."""
    with HeldInterrupts() as interrupts:
        return _run_interruptibly(source, settings, options, (on_frame, on_wait), interrupts)


def _run_interruptibly(
    source: RunInput,
    settings: Settings,
    options: RunOptions,
    watchers: tuple[Callable[[int], None], Callable[[str], None]],
    interrupts: HeldInterrupts,
) -> RunSummary:
    on_frame, on_wait = watchers
    odometry, counts, out = source.odometry, source.counts, Path(options.out)
    began = time.perf_counter()
    writer = open_outputs(
        out, rig=odometry.rig, save_points=options.save_points, video=options.video,
        view=options.view, preview=options.preview,
        force=options.force, stages=STAGES, calibration=settings.calibration.any,
        frame_number=source.frame_number if settings.objects.enabled else None,
        more=options.more_outputs,
    )  # fmt: skip

    def described(ended: str) -> RunSummary:
        counted = Counter(counts)
        counted.update(dict(odometry.counts))  # a copy: another thread may be counting
        counted["frames_written"] = writer.frames_written
        counted["frames_never_covered_by_imu"] = odometry.dropped
        return RunSummary(
            settings=settings,
            options=_options(options, source),
            imu_noise=source.imu_noise,
            source=source.identity,
            counts=counted,
            warnings=_warnings(source.warnings, options, settings, counted),
            not_started_because=odometry.not_started_because,
            ended=ended,
            wall_seconds=time.perf_counter() - began,
            preset_name=None if source.preset is None else source.preset.name,
            preset={} if source.preset is None else source.preset.in_force(settings),
        )

    ended = "finished"
    failure: BaseException | None = None
    try:
        with writer, closing(source.stream):
            write_run_json(out, described(RUNNING))
            reserve_run_json(out)
            if settings.calibration.any:
                write_chain(out / CHAIN_FILE, odometry.rig)
            counted = _counted(source.stream, counts, on_frame)
            usable = usable_events(counted, counts, settings.health.lost_after_gap_s)
            said = _saying(_checked(usable, source, on_wait), odometry, on_wait)
            updated = _updating(said, out, described)
            _write_all(_interruptible(updated, interrupts), odometry, writer, counts)
            if writer.frames_written == 0:
                why = odometry.not_started_because or "no frame was seen"
                raise OvmotError(f"{source.name}: never started: {why}")
    except BaseException as error:
        failure = error
        ended = "interrupted" if is_interrupt(error) else f"failed: {error}"
        raise
    finally:
        interrupts.hold_all()
        odometry.close()
        counts["rig_masks"] = len(write_rig_masks(out, odometry.rig_body, odometry.rig))
        summary = described(ended)
        try:
            write_run_json(out, summary)
        except OvmotError as second:
            if failure is None:
                raise
            failure.add_note(str(second))  # the first error is the one to report
    return summary


def _masks(
    sequence: RecordedSequence, settings: Settings, options: RunOptions
) -> Iterator[MaskSource]:
    """The masks of a folder, of two files, and of the data's instance images."""
    if options.masks is not None:
        yield open_masks(Path(options.masks), sequence.rig)
    if any(options.mask_files):
        left, right = (None if file is None else Path(file) for file in options.mask_files)
        yield open_mask_files((left, right), sequence.rig)
    ids = settings.masks.segmentation_ids
    if ids and sequence.instances is None:
        remedy = "leave out masks.segmentation_ids"
        raise InputError.at(sequence.root, "has no instance images", remedy)
    if ids and sequence.instances is not None:
        yield InstanceMasks.make(sequence.instances, ids, sequence.rig)


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
    for key, text in _LEFT_OUT.items():
        if counts[key]:
            warnings[text] += counts[key]
    unsure = counts["frames_degraded"] + counts["frames_lost"]
    if unsure:
        warnings["frames whose pose rests on the IMU alone (`health` in state.csv)"] += unsure
    if counts["resets"]:
        text = "new starts because the motion was lost: the position may jump there"
        warnings[text] += counts["resets"]
    refused, tested = counts["stereo_matches_refused"], counts["stereo_matches"]
    if refused > MOST_REFUSED * tested:
        text = f"stereo matches refused by the extrinsics, of {tested}: try 'ovmot doctor'"
        warnings[text] += refused
    for camera, picture in product(("left", "right"), Picture):
        if counts[f"{camera}_{picture}"]:
            text = f"{camera} pictures that were {picture}: the other camera went on alone"
            warnings[text] += counts[f"{camera}_{picture}"]
    if counts["rig_masks"]:
        text = f"masks of the rig's own body, {' and '.join(RIG_MASKS)}: give this run to --masks"
        warnings[text] += counts["rig_masks"]
    if counts["frames_without_stereo"] and settings.tracker.cameras == "stereo":
        text = "frames without a stereo match: no scale from them, and nothing seen to move"
        warnings[text] += counts["frames_without_stereo"]
    return warnings


def _options(options: RunOptions, source: RunInput) -> dict[str, str | int | None]:
    """What the run was asked for, beside its settings."""
    poses, masks = options.ego_poses, options.masks
    return {
        "ego": source.ego,
        "start": source.start,
        "ego_poses": None if poses is None else str(Path(poses).resolve()),
        "masks": None if masks is None else str(Path(masks).resolve()),
        "mask_files": ", ".join(str(file) for file in options.mask_files if file) or None,
        "first": options.first,
        "last": options.last,
    }


def _counted(
    stream: Iterable[Event], counts: Counter[str], on_frame: Callable[[int], None]
) -> Iterator[Event]:
    """The events; how many of each kind there were goes into `counts`, the frames to `on_frame`."""
    for event in stream:
        if isinstance(event, ImuSample):
            counts["imu_samples_read"] += 1
        else:
            counts["frames_read"] += 1
            on_frame(counts["frames_read"] + counts["frames_without_pose"])
        yield event


def _write_all(
    stream: Iterable[Event], odometry: Odometry, writer: RunWriter, counts: Counter[str]
) -> None:
    """Write the results of all events; their stereo matches go into `counts`."""
    for result in _results(stream, odometry):
        writer.write(result)
        accepted = result.matches.accepted
        counts["stereo_matches"] += len(accepted)
        counts["stereo_matches_refused"] += int(np.count_nonzero(~accepted))
        if isinstance(result.frame, StereoFrame) and not accepted.any():
            counts["frames_without_stereo"] += 1


def _results(stream: Iterable[Event], odometry: Odometry) -> Iterator[FrameResult]:
    for event in stream:
        yield from odometry.add(event)
    yield from odometry.finish()


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


def _checked(
    stream: Iterable[Event], source: RunInput, on_wait: Callable[[str], None]
) -> Iterator[Event]:
    """The events; what the doctor finds on the way is said, and noted as a warning."""
    check, odometry = source.check, source.odometry

    def say(line: str) -> None:
        source.warnings[line] += 1
        on_wait(line)

    for line in () if check is None else check.of_imu():
        say(line)
    for event in stream:
        yield event
        if check is None or isinstance(event, ImuSample):
            continue
        counts = Counter({**source.counts, **dict(odometry.counts)})
        for line in check.after(event.timestamp_ns, odometry.started, counts):
            say(line)


def _interruptible(stream: Iterable[Event], interrupts: HeldInterrupts) -> Iterator[Event]:
    """The events; between two of them Ctrl-C takes effect."""
    for event in stream:
        interrupts.check()
        yield event


def _updating(
    stream: Iterable[Event], out: Path, described: Callable[[str], RunSummary]
) -> Iterator[Event]:
    """The events; every few seconds, `run.json` is brought up to date."""
    written_s = time.monotonic()
    for event in stream:
        yield event
        if time.monotonic() - written_s > _UPDATE_EVERY_S:
            written_s = time.monotonic()
            if reserve_run_json(out):
                write_run_json(out, described(RUNNING))
                reserve_run_json(out)


def _with_pose(
    stream: Generator[Event, None, None], poses: GivenPosesInitializer, counts: Counter[str]
) -> Generator[Event, None, None]:
    """The events, without the frames for which a pose file has no pose; those are counted."""
    counts["frames_without_pose"] = 0
    posed = set(poses.source.pose_ns.tolist())
    with closing(stream):
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
