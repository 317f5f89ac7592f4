"""Shared by all tests: where the real recordings are, one short synthetic intervention, and its replay.

The package is imported in the fixtures: the process that hands the tests out to others needs none of it.
"""

import gc
import os
from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    import numpy as np
    from typer.testing import Result

    from data_synth.scenario.recording import ImagedHeart
    from dvf_ig.core import DvfModel, PoseStream, Scenario, SurfaceSeries
    from dvf_ig.registration import RegistrationResult
    from dvf_ig.replay import Replay

settings.register_profile("dvf_ig", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("dvf_ig")
gc.disable()  # while tests are collected, which stay to the end

REPO = Path(__file__).resolve().parent.parent
SHARED = {
    "imaged": "one intervention",
    "anatomy": "one phantom",
    "calibration_recordings": "calibration recordings",
}
"""Fixtures that take long to make, of which others are made: the tests that share one run in one process."""
SERVO = ("tests/session/", "tests/guidance/servo/")
"""Folders whose tests compile the servo. They run first and in one process, while another makes the one
intervention: two processes that need the same kernels at the same time both compile them."""


@pytest.hookimpl(tryfirst=True)  # before pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of one file, and all that share a heart or SERVO, stay in one process where several work."""
    items.sort(key=lambda item: [not item.nodeid.startswith(folder) for folder in SERVO])
    for item in items:
        names = getattr(item, "fixturenames", ())
        groups = [group for fixture, group in SHARED.items() if fixture in names]
        groups += ["servo"] * item.nodeid.startswith(SERVO)
        item.add_marker(pytest.mark.xdist_group((*groups, item.nodeid.split("::", maxsplit=1)[0])[0]))


def pytest_collection_finish() -> None:
    """Tests and modules stay to the end: the garbage collector leaves them out from here on.

    It also looks less often: tests hold large arrays and few cycles.
    """
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No test reads or writes a user's cache; processes that a test starts inherit this."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DVF_IG_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def commands_built_once() -> Iterator[None]:
    """typer builds all commands of an app anew for each call of a test, in 30 ms."""
    from typer.main import get_command

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("typer.testing._get_command", lru_cache(get_command))
        yield


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of real recordings; a test that needs it is skipped where it is absent."""
    folder = Path(os.environ.get("DVF_IG_DATA", REPO / ".." / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real recordings not found at {folder}; set DVF_IG_DATA")
    return folder.resolve()


@pytest.fixture(scope="session")
def imaged() -> "ImagedHeart":
    """The heart of `scenario` and its pre-operative images, for other recordings of it.

    The MR has half of a study's phases and larger voxels: all that reads it is quicker.
    """
    import numpy as np

    from data_synth import ScenarioSpec
    from data_synth.mr.cine import MrProtocol, cine_preop
    from data_synth.scenario.recording import ImagedHeart, scenario_heart

    spec = ScenarioSpec(motion="paper5mm", seed=77)
    anatomy = scenario_heart(spec)
    protocol = MrProtocol(phases=10, spacing_mm=2.4)
    return ImagedHeart(spec, anatomy, cine_preop(anatomy, np.random.default_rng(77), protocol))


@pytest.fixture(scope="session")
def scenario(imaged: "ImagedHeart") -> "Scenario":
    """17 s of the synthetic operating room: long enough to register and to touch."""
    from data_synth import ScenarioSpec, phantom_scenario

    spec = ScenarioSpec(preset="calm", motion="paper5mm", seconds=17.0, seed=77)
    return phantom_scenario(spec, imaged=imaged)


@pytest.fixture(scope="session")
def brief(scenario: "Scenario") -> "Scenario":
    """The scenario with two seconds of its frames: images are most of what a folder holds."""
    from dataclasses import replace

    whole, few = scenario.ultrasound, slice(24)
    assert whole.images is not None

    def begin(stream: "PoseStream") -> "PoseStream":
        names = ("t_s", "rotations", "translations_mm", "valid")
        return replace(stream, **{name: getattr(stream, name)[few] for name in names})

    poses = {name: begin(stream) for name, stream in whole.poses.items()}
    frames = replace(
        whole,
        t_s=whole.t_s[few],
        images=whole.images[few],
        image_valid=whole.image_valid[few],
        poses=poses,
    )
    return replace(scenario, ultrasound=frames)


@pytest.fixture(scope="session")
def written(scenario: "Scenario", tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario's folder, for tests that only read it."""
    from dvf_ig.intake import write_scenario

    folder = tmp_path_factory.mktemp("written") / "scenario"
    write_scenario(scenario, folder)
    return folder


@pytest.fixture(scope="session")
def shared_hearts() -> Iterator[None]:
    """Replays of one patient with one model share what `build_heart` makes of these two alone."""
    from dvf_ig.replay import engine
    from dvf_ig.session.heart import build_heart

    made = lru_cache(maxsize=2)(build_heart)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "build_heart", lambda preop, model=None, progress=None: made(preop, model))
        yield


@pytest.fixture(scope="session")
def replay(scenario: "Scenario", shared_hearts: None) -> "Replay":
    from dvf_ig.intake import cached_model
    from dvf_ig.replay import run_replay

    return run_replay(scenario, model=cached_model(scenario.preop).model, seed=0)


@pytest.fixture(scope="session")
def registered(replay: "Replay") -> "RegistrationResult":
    """The first registration of the shared replay that may be used."""
    result = next(attempt.result for attempt in replay.attempts if attempt.usable)
    assert result is not None
    return result


@pytest.fixture
def known_registrations(
    replay: "Replay", registered: "RegistrationResult", monkeypatch: pytest.MonkeyPatch
) -> None:
    """A session's registrations have the results of the shared replay's, in their order, at no cost."""
    known = chain((attempt.result for attempt in replay.attempts), repeat(registered))
    monkeypatch.setattr("dvf_ig.session.arrived_ultrasound.register_frames", lambda *_, **__: next(known))


@pytest.fixture(scope="session")
def commanded(
    replay: "Replay", written: Path, tmp_path_factory: pytest.TempPathFactory
) -> "tuple[Path, Result]":
    """The folder of the shared replay as the command writes it, only to be read, and what it said."""
    from typer.testing import CliRunner

    from dvf_ig.cli.main import app

    folder = tmp_path_factory.mktemp("replayed") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.replay.run_replay", lambda *_, **__: replay)
        done = CliRunner().invoke(app, ["replay", str(written), "-o", str(folder), "--json"])
    assert done.exit_code == 0, done.output
    return folder, done


@pytest.fixture(scope="session")
def run(commanded: "tuple[Path, Result]") -> Path:
    """The folder of `commanded`."""
    return commanded[0]


@pytest.fixture
def blank_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For a test of a page's words, or of what is written beside it."""
    monkeypatch.setattr("dvf_ig.report.page.png_bytes", lambda _: b"")


@pytest.fixture(scope="session")
def ball() -> "DvfModel":
    """A beating, drifting ball whose distance field is known in closed form."""
    from toy_ball import ball_model

    return ball_model()


@pytest.fixture(scope="session")
def sphere_of() -> "Callable[..., tuple[np.ndarray, np.ndarray]]":
    from toy_sphere import sphere

    return sphere


@pytest.fixture(scope="session")
def beating_sphere() -> "SurfaceSeries":
    from toy_sphere import beating_sphere_series

    return beating_sphere_series()
