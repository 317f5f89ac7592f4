"""Shared by the tests of the live link: registration that reads the toy's images."""

import pytest
from toy_session import compare_known, register_known


@pytest.fixture
def known_images(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is done with pixels is replaced by what the toy's pixels say."""
    monkeypatch.setattr("dvf_ig.session.ultrasound_source.register_frames", register_known)
    monkeypatch.setattr("dvf_ig.session.ultrasound_source.compare_beat", compare_known)
