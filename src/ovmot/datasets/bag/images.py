"""Images of ROS messages, in grey and 8 bits.

Encodings are those of `sensor_msgs/image_encodings`; a Bayer pattern is named by its first two
rows, so `bayer_rggb8` has red at the origin.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np

from ovmot.datasets.images import decode
from ovmot.datasets.sequence import StoredImage
from ovmot.errors import DatasetError
from ovmot.geometry.arrays import AnyArray, Image


def _by(code: int) -> Callable[[AnyArray], AnyArray]:
    return lambda pixels: np.asarray(cv2.cvtColor(pixels, code))


def _same(pixels: AnyArray) -> AnyArray:
    return pixels


def _high_byte(pixels: AnyArray) -> AnyArray:
    return np.asarray(pixels >> 8)


@dataclass(frozen=True, slots=True)
class _Encoding:
    """Bytes of a channel, channels of a pixel, and the way to grey."""

    depth: int
    channels: int
    to_grey: Callable[[AnyArray], AnyArray]


_BAYER = {
    "bayer_rggb8": _Encoding(1, 1, _by(cv2.COLOR_BayerRGGB2GRAY)),
    "bayer_bggr8": _Encoding(1, 1, _by(cv2.COLOR_BayerBGGR2GRAY)),
    "bayer_gbrg8": _Encoding(1, 1, _by(cv2.COLOR_BayerGBRG2GRAY)),
    "bayer_grbg8": _Encoding(1, 1, _by(cv2.COLOR_BayerGRBG2GRAY)),
}
ENCODINGS = {
    "mono8": _Encoding(1, 1, _same),
    "8UC1": _Encoding(1, 1, _same),
    "mono16": _Encoding(2, 1, _high_byte),
    "16UC1": _Encoding(2, 1, _high_byte),
    "bgr8": _Encoding(1, 3, _by(cv2.COLOR_BGR2GRAY)),
    "8UC3": _Encoding(1, 3, _by(cv2.COLOR_BGR2GRAY)),
    "rgb8": _Encoding(1, 3, _by(cv2.COLOR_RGB2GRAY)),
    "bgra8": _Encoding(1, 4, _by(cv2.COLOR_BGRA2GRAY)),
    "rgba8": _Encoding(1, 4, _by(cv2.COLOR_RGBA2GRAY)),
    **_BAYER,
}
_REMEDY = f"known: {', '.join(ENCODINGS)}, and jpeg or png in compressed topics"


def stored_image(message: Any, where: str) -> StoredImage:
    """A `sensor_msgs/Image` or `CompressedImage`, to be decoded when it is needed.

    Any class with the message's fields will do, of a bag or live. Raises `DatasetError` with
    `where` for an encoding that is not known; decoding raises it for a broken image.
    """
    if hasattr(message, "format"):
        if "compressedDepth" in message.format:
            raise DatasetError.at(where, f"unknown encoding '{message.format}'", _REMEDY)
        return StoredImage(where, partial(_compressed, message, where))
    encoding = ENCODINGS.get(message.encoding)
    if encoding is None:
        raise DatasetError.at(where, f"unknown encoding '{message.encoding}'", _REMEDY)
    return StoredImage(where, partial(_plain, message, encoding, where))


def _plain(message: Any, encoding: _Encoding, where: str) -> Image:
    height, width, step = message.height, message.width, message.step
    data, row = np.frombuffer(message.data, dtype=np.uint8), encoding.depth * encoding.channels
    if data.size < height * step or step < width * row or min(height, width) < 1:
        problem = f"{data.size} bytes are no image of {width}x{height} pixels, {step} bytes a row"
        raise DatasetError.at(where, problem, "record the topic again")
    pixels = data[: height * step].reshape(height, step)[:, : width * row]
    if encoding.depth == 2:
        pixels = np.ascontiguousarray(pixels).view(">u2" if message.is_bigendian else "<u2")
    elif encoding.channels > 1:
        pixels = np.ascontiguousarray(pixels).reshape(height, width, encoding.channels)
    return np.ascontiguousarray(encoding.to_grey(pixels), dtype=np.uint8)


def _compressed(message: Any, where: str) -> Image:
    data = bytes(message.data)
    pattern = _BAYER.get(message.format.partition(";")[0].strip())
    if pattern is not None:  # png of a raw pattern; jpeg is made of its colours
        pixels = decode(data, where, cv2.IMREAD_UNCHANGED)
        if pixels.ndim == 2:
            return np.asarray(pattern.to_grey(pixels), dtype=np.uint8)
    return np.asarray(decode(data, where, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
