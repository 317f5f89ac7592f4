"""Shared by all tests: where the real recordings are, and a hypothesis profile without deadlines."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("dvf_ig", deadline=None, derandomize=True)
settings.load_profile("dvf_ig")

REPO = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings; a test that needs it is skipped where it is absent."""
    folder = Path(os.environ.get("DVF_IG_DATA", REPO / ".." / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real recordings not found at {folder}; set DVF_IG_DATA")
    return folder.resolve()
