"""The single mistake that would explain a refused registration, on one that only looks at its input."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from toy_lab import sweep

from dvf_ig.core import Rigid
from dvf_ig.replay.registration import PreparedRegistration, explain_refusal
from dvf_ig.session import UltrasoundRecording

START = Rigid("mr", "tracker", np.eye(3), np.array([10.0, 20.0, 30.0]))


def prepared() -> PreparedRegistration:
    recording = UltrasoundRecording(sweep(), 0, None, None, (), None, "two-segment")
    return PreparedRegistration(None, recording, None, START)


@pytest.mark.parametrize(
    ("mistake", "words"),
    [
        ("mirrored", "mirrored left to right"),
        ("upside down", "mirrored top to bottom"),
        ("flipped", "the start is in RAS"),
        ("another", None),
    ],
)
def test_the_mistake_that_is_undone_is_named(
    monkeypatch: pytest.MonkeyPatch, mistake: str, words: str | None
) -> None:
    recorded = prepared()

    def register(self: PreparedRegistration, **_: Any) -> Any:
        images, before = self.recording.images, recorded.recording.images
        usable = {
            "mirrored": np.array_equal(images, before[:, :, ::-1]),
            "upside down": np.array_equal(images, before[:, ::-1]),
            "flipped": np.array_equal(self.start.translation_mm, [-10.0, -20.0, 30.0]),
            "another": False,
        }
        return SimpleNamespace(stop=SimpleNamespace(usable=usable[mistake]))

    monkeypatch.setattr(PreparedRegistration, "register", register)
    cause = explain_refusal(recorded)
    assert (cause is None) if words is None else (cause is not None and words in cause)
