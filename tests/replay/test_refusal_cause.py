"""The single mistake that would explain a refused registration, on one that only looks at its input."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_lab import sweep

from dvf_ig.core import ImageMap, Rigid
from dvf_ig.registration import Evidence
from dvf_ig.registration.evidence.image_offset import ImageOffset
from dvf_ig.replay.registration import PreparedRegistration, explain_refusal
from dvf_ig.session import UltrasoundCalibration, UltrasoundRecording

START = Rigid("mr", "tracker", np.eye(3), np.array([10.0, 20.0, 30.0]))


def prepared() -> PreparedRegistration:
    image = ImageMap(Rigid("probe", "image", np.eye(3), np.zeros(3)), np.ones(2))
    calibrations = UltrasoundCalibration(image, 0.0)
    recording = UltrasoundRecording(sweep(), 0, None, None, (), calibrations, "two-segment")
    return PreparedRegistration(None, recording, None, START)


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        ("mirrored", "mirrored left to right"),
        ("upside down", "mirrored top to bottom"),
        ("flipped", "the start is in RAS"),
        ("calibrated another day", "moved by 4.0 mm and turned by 2.0° on its probe"),
        ("another", None),
    ],
)
def test_the_mistake_that_is_undone_is_named(
    monkeypatch: pytest.MonkeyPatch, mistake: str, words: str | None
) -> None:
    recorded = prepared()
    moved = Rigid("probe", "image", np.eye(3), np.array([4.0, 0.0, 0.0]))
    offset = ImageOffset(moved, Rigid("mr", "tracker", np.eye(3), np.zeros(3)), 4.0, 2.0, 30.0)

    def register(self: PreparedRegistration, **_: Any) -> Any:
        images, before = self.recording.images, recorded.recording.images
        usable = {
            "mirrored": np.array_equal(images, before[:, :, ::-1]),
            "upside down": np.array_equal(images, before[:, ::-1]),
            "flipped": np.array_equal(self.start.translation_mm, [-10.0, -20.0, 30.0]),
            "calibrated another day": self.start is offset.pose
            and self.recording.calibrations.probe_from_image.rigid is offset.probe_from_image,
            "another": False,
        }
        return SimpleNamespace(stop=SimpleNamespace(usable=usable[mistake]))

    monkeypatch.setattr(PreparedRegistration, "register", register)
    cause = explain_refusal(recorded, SimpleNamespace(evidence=Evidence(9.0, 0.5, image_offset=offset)))
    assert (cause is None) if words is None else (cause is not None and words in cause)
