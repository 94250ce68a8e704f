"""Writes pictures into a movie: .mp4 by ffmpeg, .gif by Pillow. Needs `carom[movie]`."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import imageio_ffmpeg
from PIL import Image

from carom.errors import RecordingError
from carom.recording.write.whole_file import whole_file

# with these options, thin lines on a dark background remain legible
_QUALITY = ("-crf", "18", "-preset", "medium", "-movflags", "+faststart")
_HUNDREDTHS = 100  # hundredths in a second: the unit of time of a GIF


def write_movie(path: Path, pictures: Iterable[bytes], count: int, size: tuple[int, int], fps: float) -> None:
    """Write ``count`` PNGs of one size (pixels) into a movie, an .mp4 or a .gif; an incomplete file is removed.

    Width and height are even for .mp4, and ``fps`` is in pictures per second. Raises RecordingError if there is no
    ffmpeg, or the file cannot be written.
    """
    try:
        with whole_file(path) as part:
            if path.suffix == ".gif":
                few = (  # a GIF has a palette for each picture
                    image.quantize(colors=256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
                    for image in map(_pixels, pictures)
                )
                duration = delays_of(count, fps)
                next(few).save(part, save_all=True, append_images=few, duration=duration, loop=0, format="GIF")
            else:
                with _encoder(part, size, fps) as send:
                    for image in map(_pixels, pictures):
                        send(image.tobytes())
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error


def require_encoder(path: Path) -> None:
    """Raise RecordingError if the movie needs ffmpeg and there is none."""
    if path.suffix == ".gif":
        return
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError:
        raise RecordingError(
            f"{path}: an .mp4 needs ffmpeg, which is not installed; install it (apt-get install ffmpeg), name it in "
            "IMAGEIO_FFMPEG_EXE, or write a .gif"
        ) from None


def _pixels(png: bytes) -> Image.Image:
    return Image.open(io.BytesIO(png)).convert("RGB")


@contextlib.contextmanager
def _encoder(path: Path, size: tuple[int, int], fps: float) -> Iterator[Callable[[bytes], Any]]:
    """Start ffmpeg; yield the function that writes the pixels of a picture."""
    writer = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,
        codec="libx264",
        quality=None,
        macro_block_size=2,  # block size of yuv420p; the default, 16, would scale the pictures
        output_params=list(_QUALITY),
        ffmpeg_log_level="error",
    )
    try:
        writer.send(None)
        yield writer.send
    finally:
        writer.close()


def delays_of(count: int, fps: float) -> list[int]:
    """Return the duration (ms) of each picture of a GIF: whole hundredths of a second with the correct sum."""
    ends = [round(_HUNDREDTHS * number / fps) for number in range(count + 1)]
    return [10 * (end - start) for start, end in pairwise(ends)]
