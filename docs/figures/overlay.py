"""The README's moving picture, and the still one: the overlay of a run on the demo street.

python docs/figures/overlay.py
"""

from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

import ovmot
from common import IMAGES, street

LIMIT_BYTES = 3_000_000
SIZES = ((720, 1), (720, 2), (640, 2), (560, 2), (480, 2), (480, 3), (360, 4))
"""Width in pixels, and every how manieth frame: the first that fits into the limit is taken."""


def main(folder: Path = IMAGES, **simulated: Any) -> Path:
    """Run with the overlay, and write `overlay.gif` and `overlay.jpg`."""
    data, _ = street("demo", **({"size": (640, 280)} | simulated))
    out = data.parent / "overlay"
    options = ovmot.RunOptions(out, video=True, force=True)
    ovmot.run_sequence(ovmot.open(data), ovmot.Settings(), options)
    frames = frames_of(out / "overlay.mp4")
    still = fitted(frames[2 * len(frames) // 3], 960)
    still.save(folder / "overlay.jpg", quality=80)
    return write_gif(frames, folder / "overlay.gif")


def frames_of(video: Path) -> list[Image.Image]:
    """All frames of a video."""
    with av.open(str(video)) as file:
        return [Image.fromarray(frame.to_ndarray(format="rgb24")) for frame in file.decode(video=0)]


def fitted(image: Image.Image, width: int) -> Image.Image:
    """The image at this width, or as it is where it is narrower."""
    width = min(width, image.width)
    height = round(image.height * width / image.width)
    return image.resize((width, height), Image.Resampling.LANCZOS)


def palette_of(frames: list[Image.Image]) -> Image.Image:
    """A palette of 40 greys, as the camera's, and of the 56 colours that most is drawn with."""
    pixels = np.concatenate([np.asarray(frame).reshape(-1, 3) for frame in frames[::4]])
    coloured = pixels[np.ptp(pixels.astype(int), axis=1) > 60]
    greys = np.repeat(np.linspace(0, 255, 40).astype(np.uint8), 3)
    colours = Image.fromarray(coloured[None]).quantize(56).getpalette() if len(coloured) else []
    palette = Image.new("P", (1, 1))
    palette.putpalette([*greys.tolist(), *(colours or [])])
    return palette


def write_gif(frames: list[Image.Image], path: Path, frame_ms: int = 100) -> Path:
    """Write frames of `frame_ms` as a GIF that repeats, as large as the limit allows."""
    for width, step in SIZES:
        small = [fitted(frame, width) for frame in frames[::step]]
        palette = palette_of(small)
        drawn = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in small]
        drawn[0].save(
            path, save_all=True, append_images=drawn[1:], duration=frame_ms * step, loop=0,
            optimize=True,
        )  # fmt: skip
        if path.stat().st_size < LIMIT_BYTES:
            break
    return path


if __name__ == "__main__":
    ovmot.prepare_process()
    main()
