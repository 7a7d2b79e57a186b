"""Images from files, as grey of 8 bits; a truncated image is an error."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np

from ovmot.errors import DatasetError
from ovmot.geometry.arrays import AnyArray, Image
from ovmot.text_files import LFS_POINTER, LFS_REMEDY, is_lfs_pointer

SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_REMEDY = "copy the file again or take the frame out of the sequence"


def read_grey(path: Path) -> Image:
    """The image (height, width) in grey, colour converted, 16 bits scaled to 8.

    Raises `DatasetError` if the file is empty, truncated, corrupt or no image.
    """
    return decode(_read_bytes(path), path, cv2.IMREAD_GRAYSCALE).astype(np.uint8, copy=False)


def read_bayer_as_grey(path: Path) -> Image:
    """A raw Bayer image (KAIST: red at the origin, OpenCV's `BAYER_RG`) demosaiced to grey.

    An image that has been turned to colour before is only converted. Errors as `read_grey`.
    """
    raw = decode(_read_bytes(path), path, cv2.IMREAD_UNCHANGED)
    if raw.ndim == 3:
        return read_grey(path)
    if raw.dtype == np.uint16:
        raw = raw >> 8
    grey = cv2.cvtColor(raw.astype(np.uint8, copy=False), cv2.COLOR_BAYER_RG2GRAY)
    return np.asarray(grey, dtype=np.uint8)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels; of a PNG without decoding it."""
    head = _read_bytes(path)[:24]
    if head.startswith(_PNG_SIGNATURE) and len(head) == 24:
        width, height = struct.unpack(">II", head[16:24])
        return int(width), int(height)
    rows, columns = read_grey(path).shape
    return columns, rows


def _read_bytes(path: Path) -> bytes:
    if path.exists() and not path.is_file():  # a pipe would never end
        raise DatasetError.at(path, "is no file", _REMEDY)
    try:
        return path.read_bytes()
    except OSError as error:
        raise DatasetError.at(path, f"cannot read the image: {error.strerror}", _REMEDY) from None


def decode(data: bytes, where: Path | str, mode: int) -> AnyArray:
    """The image in the bytes of a file, by a mode of `cv2.imdecode`.

    Raises `DatasetError` with `where` if it is empty, truncated, corrupt or no image.
    """
    if not data:
        raise DatasetError.at(where, "the image file is empty", _REMEDY)
    if is_lfs_pointer(data[:64]):
        raise DatasetError.at(where, LFS_POINTER, LFS_REMEDY)
    if data.startswith(_PNG_SIGNATURE):
        _check_png(where, data)
    elif data.startswith(b"\xff\xd8") and data.rfind(b"\xff\xd9") < 0:
        raise DatasetError.at(where, "the image is truncated", _REMEDY)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), mode)
    except cv2.error:
        image = None
    if image is None:
        raise DatasetError.at(where, "not an image that OpenCV can read", _REMEDY)
    return image


def _check_png(where: Path | str, data: bytes) -> None:
    """Walk the chunks up to the end mark: decoders take a truncated file for a grey-bottomed one.

    Chunks: length, type, data, CRC-32 of type and data (W3C PNG specification, section 5.3).
    """
    view = memoryview(data)
    at = len(_PNG_SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(view[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            raise DatasetError.at(where, "the image is corrupt (PNG checksum)", _REMEDY)
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end + 4
    raise DatasetError.at(where, "the image is truncated (PNG without its end)", _REMEDY)
