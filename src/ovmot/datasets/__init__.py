"""Recorded sequences: open a folder, then read its events in time order."""

from ovmot.datasets.registry import READERS, Reader, open_sequence
from ovmot.datasets.sequence import FolderSequence
from ovmot.datasets.stream import events

__all__ = ["READERS", "FolderSequence", "Reader", "events", "open_sequence"]
