"""Where a command takes the patient's model from, and that it says so."""

from pathlib import Path

import pytest

from dvf_ig.cli.session_argument import patient_model
from dvf_ig.core import InvalidInputError, Preop, SurfaceSeries
from dvf_ig.io import model_digest, write_model


def test_built_then_cached_then_given(
    beating_sphere: SurfaceSeries, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DVF_IG_CACHE", str(tmp_path))
    preop = Preop(beating_sphere.patient_id, surfaces=(beating_sphere,), surface=beating_sphere.name)
    built, origin = patient_model(preop, None)
    assert origin.startswith(f"model built and stored in {tmp_path}")
    cached, origin = patient_model(preop, None)
    assert origin.startswith(f"model from the cache: {tmp_path}")
    assert model_digest(built) == model_digest(cached)
    file = tmp_path / "given.npz"
    write_model(built, file)
    for entry in (tmp_path / "models").iterdir():
        entry.unlink()
    given, origin = patient_model(preop, file)
    assert model_digest(given) == model_digest(built)
    assert origin == f"model from {file}"
    with pytest.raises(InvalidInputError, match="needed patient 'nobody'"):
        patient_model(Preop("nobody", surfaces=(beating_sphere,)), file)
