"""Encode ultrasound frames for a page: position in the model's frame, and compressed picture."""

import base64
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.kernels.compiled import thread_count

from .packing import packed_exactly
from .scene import ImageShape

SENT_COLUMNS = 256
MOST_FRAMES = 800
"""Most frames that are sent: 12 Hz for a minute; of more every second, third, … is sent."""
MOST_BYTES = 3_500_000
"""Most bytes of all pictures of a file; their quality is chosen to fit."""
QUALITIES = (75, 60, 50, 40, 30, 20, 10)
PROBED = 12
"""Frames that are tried with each quality."""
LIVE_QUALITY = 70


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class FrameSeries:
    """Ultrasound frames over time.

    Attributes:
        event_s: (n,) time of each, tracker clock.
        model_phase: (n,) phase in the model's cycle; NaN if unknown.
        mr_from_recorded: (n, 3, 3) maps recorded (column, row, 1) to mm; NaN without a pose.
        images: (n, rows, columns) as recorded.
        shape: of the sent images.
    """

    event_s: FloatArray
    model_phase: FloatArray
    mr_from_recorded: FloatArray
    images: NDArray[np.uint8]
    shape: ImageShape


def frames_payload(frames: FrameSeries) -> dict[str, Any]:
    """Encode all frames, or every n-th of a long recording, as WebP within MOST_BYTES."""
    every = -(-len(frames.event_s) // MOST_FRAMES)
    chosen = np.arange(0, len(frames.event_s), every)
    images = [sent_image(frames.images[i], frames.shape) for i in chosen]
    quality = _quality(images)
    with ThreadPoolExecutor(thread_count()) as pool:  # the encoder lets other threads run
        pictures = list(pool.map(lambda image: _text(_webp(image, quality)), images))
    phases = frames.model_phase[chosen].round(6)
    return {
        "event_s": frames.event_s[chosen].round(6).tolist(),
        "model_phase": [None if np.isnan(phase) else phase for phase in phases.tolist()],
        "mr_from_pixel": packed_exactly(frames.mr_from_recorded[chosen] @ frames.shape.recorded_from_sent),
        "images": pictures,
        "mime": "image/webp",
    }


def frame_event(
    image: NDArray[np.uint8],
    shape: ImageShape,
    event_s: float,
    model_phase: float | None,
    mr_from_recorded: FloatArray | None,
) -> dict[str, Any]:
    """Build the field `frame` of a live event.

    Args:
        image: (rows, columns) as received.
        shape: of the sent images.
        event_s: time of the image.
        model_phase: phase in the model's cycle; None if unknown.
        mr_from_recorded: (3, 3) maps its (column, row, 1) to mm; None without a pose.
    """
    placed = None if mr_from_recorded is None else mr_from_recorded @ shape.recorded_from_sent
    settings = [cv2.IMWRITE_JPEG_QUALITY, LIVE_QUALITY]
    return {
        "event_s": round(event_s, 6),
        "model_phase": model_phase,
        "mr_from_pixel": None if placed is None else placed.round(6).tolist(),
        "image": _text(cv2.imencode(".jpg", sent_image(image, shape), settings)[1].tobytes()),
        "mime": "image/jpeg",
    }


def sent_image(image: NDArray[np.uint8], shape: ImageShape) -> NDArray[np.uint8]:
    """Resize an image to the size in which it is sent."""
    size = (shape.columns, shape.rows)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _quality(images: list[NDArray[np.uint8]]) -> int:
    """Choose the best quality at which all images fit."""
    probes = [images[i] for i in np.linspace(0, len(images) - 1, min(PROBED, len(images))).astype(int)]
    for quality in QUALITIES:
        mean = float(np.mean([len(_webp(image, quality)) for image in probes]))
        if mean * len(images) <= MOST_BYTES:
            return quality
    return QUALITIES[-1]


def _webp(image: NDArray[np.uint8], quality: int) -> bytes:
    return bytes(cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes())


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
