"""A session whose ultrasound says where the patient is."""

import pytest
from toy_session import compare_known, register_known


@pytest.fixture
def known_ultrasound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are registered and beats compared by what the toy's images say; see `toy_session`."""
    monkeypatch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", register_known)
    monkeypatch.setattr("dvf_ig.session.arrived_ultrasound.compare_beat", compare_known)
