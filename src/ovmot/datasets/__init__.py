"""Recorded sequences: open a folder, then read its events in time order."""

from ovmot.datasets.registry import (
    DATASETS,
    WRITERS,
    Dataset,
    Reader,
    open_recording,
    open_sequence,
)
from ovmot.datasets.sequence import FolderSequence, RecordedSequence
from ovmot.datasets.stream import events

__all__ = [
    "DATASETS",
    "WRITERS",
    "Dataset",
    "FolderSequence",
    "Reader",
    "RecordedSequence",
    "events",
    "open_recording",
    "open_sequence",
]
