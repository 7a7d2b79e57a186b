"""What to do about the warnings of a run, in plain words."""

_REMEDIES: tuple[tuple[str, str], ...] = (
    (
        "refused by the extrinsics",
        "The calibration does not fit these images. Check it with 'ovmot doctor', and let 'ovmot"
        " calibrate' estimate it.",
    ),
    (
        "rests on the IMU alone",
        "The cameras saw too little there: darkness, blur, a blank wall, or a lens covered. The"
        " position drifts until they see again; use it with its sigma.",
    ),
    (
        "the position may jump",
        "Do not compare positions across the jump: 'segment' in state.csv tells the parts.",
    ),
    (
        "that the IMU never covered",
        "The IMU's samples end before the images, or the clocks differ. Check with 'ovmot doctor'.",
    ),
    (
        "before the start, without a pose",
        "The filter needs a short time at rest, or about a second of motion, before its first"
        " pose. A few frames are normal.",
    ),
    (
        "the clock was set back",
        "Record with a clock that does not jump (PTP, or the sensor's own clock).",
    ),
    (
        "whose stamp does not follow",
        "Samples came late or twice. A few do no harm; many point to the driver or the recording.",
    ),
    (
        "left out as spikes",
        "A few do no harm. Many point to a loose cable or to wrong units.",
    ),
    (
        "at the end of the sensor's range",
        "The motion was quicker than the IMU can measure: choose a wider range, or damp the mount.",
    ),
    (
        "the other camera went on alone",
        "Look at these images: a camera stopped, was blinded, or gave the same image again.",
    ),
    (
        "masks of the rig's own body",
        "The rig sees itself. Give this run's folder to --masks the next time.",
    ),
    (
        "without a stereo match",
        "Check that both cameras are connected the right way round and exposed together: 'ovmot"
        " doctor'.",
    ),
    (
        "for which it has no pose",
        "The pose file does not cover these frames; check its stamps.",
    ),
    (
        "objects are off",
        "Moving objects need a second camera.",
    ),
    (
        "the IMU noise of the settings is used",
        "Give the IMU's noise densities with --set imu.gyro_noise=... and the like, from its data"
        " sheet.",
    ),
    (
        "stamps have no images",
        "These frames are missing in the recording. A few do no harm.",
    ),
    (
        "dropped",
        "These rows were not used. A few do no harm; many point to the recording.",
    ),
)
"""A part of a warning, and what to do; the first that fits is taken."""

_GENERAL = "See the page on faults in the documentation."


def remedy_of(message: str) -> str:
    """What to do about a warning of a run."""
    return next((remedy for part, remedy in _REMEDIES if part in message), _GENERAL)


def remedy_of_ending(ended: str) -> str:
    """What to do about a run that did not finish; empty for one that did."""
    if ended == "finished":
        return ""
    if ended == "running":
        return "The run still goes on, or its process was killed; what is here is whole."
    if ended == "interrupted":
        return "The run was stopped; what is here is whole."
    return "What is here is whole up to that point."
