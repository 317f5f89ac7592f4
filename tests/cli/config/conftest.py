"""A lab's folder of files that fit."""

import shutil
from pathlib import Path

import pytest
from toy_lab import write_lab

from dvf_ig.core import DvfModel


@pytest.fixture(scope="package")
def files(ball: DvfModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lab")
    write_lab(folder, ball)
    return folder


@pytest.fixture
def lab(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A lab's folder, to be spoilt; its images show no heart, so that no registration is prepared."""
    monkeypatch.setattr("dvf_ig.replay.registration.prepare_registration", lambda *_, **__: None)
    return Path(shutil.copytree(files, tmp_path / "lab"))
