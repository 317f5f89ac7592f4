"""The model cache: one build a patient, never stale, never another's, bounded, and off where asked."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dvf_ig
from dvf_ig.core import CycleTiming, Grid, Preop, SurfaceSeries, Volume, VolumeSeries
from dvf_ig.intake import model_cache
from dvf_ig.intake.model_cache import CachedModel, cache_folder, cached_model, model_key
from dvf_ig.io import model_digest
from dvf_ig.preop import ModelOptions

COARSE = ModelOptions(knot_spacing_mm=10.0, margin_mm=5.0)


@pytest.fixture
def preop(beating_sphere: SurfaceSeries) -> Preop:
    return Preop(beating_sphere.patient_id, surfaces=(beating_sphere,), surface=beating_sphere.name)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("DVF_IG_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "models"


def entry(found: CachedModel) -> Path:
    assert found.path is not None
    return found.path


def labelled() -> Preop:
    values = np.zeros((2, 6, 6, 6), dtype=np.uint8)
    values[:, 2:4, 2:4, 2:4] = 1
    grid = Grid.axis_aligned("mr", (6, 6, 6), np.zeros(3), 2.0)
    return Preop("p", labels=VolumeSeries(grid, values, CycleTiming.uniform(2, 0.8)), organ_labels=(1,))


def test_a_model_is_built_once(preop: Preop, folder: Path) -> None:
    first = cached_model(preop, options=COARSE)
    second = cached_model(preop, options=replace(COARSE, threads=1))
    assert (first.was_cached, second.was_cached) == (False, True)
    assert model_digest(first.model) == model_digest(second.model)
    assert entry(first) == entry(second)
    assert entry(first).parent == folder
    assert first.remark == f"model built and stored in {first.path}"
    assert second.remark == f"model from the cache: {first.path}"


SURFACE_CHANGES: dict[str, Callable[[Preop], Preop]] = {
    "vertex": lambda p: with_surface(p, vertices_mm=p.surfaces[0].vertices_mm + 1e-9),
    "triangles": lambda p: with_surface(p, triangles=p.surfaces[0].triangles[::-1]),
    "rr": lambda p: with_surface(p, timing=replace(p.surfaces[0].timing, rr_s=0.91)),
    "assumed": lambda p: with_surface(p, timing=replace(p.surfaces[0].timing, rr_assumed=True)),
    "caps": lambda p: with_surface(p, caps=~p.surfaces[0].caps),
    "name": lambda p: replace(with_surface(p, name="LV_ENDOCARDIAL"), surface="LV_ENDOCARDIAL"),
    "patient": lambda p: replace(p, patient_id="someone else"),
    "another surface": lambda p: replace(
        p, surfaces=(*p.surfaces, replace(p.surfaces[0], name="LV_ENDOCARDIAL"))
    ),
}


def with_surface(preop: Preop, **changes: object) -> Preop:
    return replace(preop, surfaces=(replace(preop.surfaces[0], **changes),))


@pytest.mark.parametrize("change", SURFACE_CHANGES)
def test_another_surface_has_another_key(preop: Preop, change: str) -> None:
    assert model_key(SURFACE_CHANGES[change](preop), COARSE) != model_key(preop, COARSE)


def with_labels(preop: Preop, **changes: object) -> Preop:
    assert preop.labels is not None
    return replace(preop, labels=replace(preop.labels, **changes))


def test_other_labels_have_another_key() -> None:
    preop = labelled()
    assert preop.labels is not None
    values = preop.labels.values.copy()
    values[0, 2, 2, 2] = 0
    grid = preop.labels.grid
    others = [
        with_labels(preop, values=values),
        with_labels(preop, grid=replace(grid, origin_mm=grid.origin_mm + 1e-9)),
        with_labels(preop, timing=CycleTiming(np.array([0.0, 0.4]), 0.8)),
        replace(preop, organ_labels=(1, 2)),
        replace(preop, label_names=((1, "lv_blood"),)),
        replace(preop, cavity_labels=(1,)),
    ]
    keys = {model_key(p, COARSE) for p in (preop, *others)}
    assert len(keys) == 1 + len(others)


def test_another_cine_or_end_diastole_has_another_key() -> None:
    series = labelled().labels
    assert series is not None
    preop = Preop("p", mr=series, ed_labels=series.phase(0))
    values = series.values.copy()
    values[0, 2, 2, 2] = 0
    others = [
        labelled(),
        replace(preop, mr=replace(series, values=values)),
        replace(preop, mr=replace(series, timing=CycleTiming(np.array([0.0, 0.4]), 0.8))),
        replace(preop, ed_labels=Volume(series.grid, values[0])),
        replace(preop, ed_phase=1),
        replace(preop, organ_labels=(1,)),
        replace(preop, cavity_labels=(1,)),
        replace(preop, label_names=((1, "blood"),)),
        replace(preop, surface="HEART"),
    ]
    keys = {model_key(p, COARSE) for p in (preop, *others)}
    assert len(keys) == 1 + len(others)


@pytest.mark.parametrize(
    "options", [{"knot_spacing_mm": 9.0}, {"margin_mm": 6.0}, {"band_mm": 2.0}, {"accuracy_mm": 0.5}]
)
def test_other_options_have_another_key(preop: Preop, options: dict[str, float]) -> None:
    assert model_key(preop, replace(COARSE, **options)) != model_key(preop, COARSE)


def test_another_program_has_another_key(
    preop: Preop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The source files that build a model count: an edit makes what was kept before unreachable."""
    (tmp_path / "preop").mkdir()
    source = tmp_path / "preop" / "build.py"
    keys = []
    with monkeypatch.context() as patch:
        patch.setattr(dvf_ig, "__file__", str(tmp_path / "__init__.py"))
        for text in ("a = 1\n", "a = 2\n"):
            source.write_text(text)
            model_cache._program.cache_clear()
            keys.append(model_key(preop, COARSE))
    model_cache._program.cache_clear()
    assert len({*keys, model_key(preop, COARSE)}) == 3


@pytest.mark.parametrize("damage", ["byte", "cut", "empty", "text"])
def test_a_damaged_entry_is_built_again(preop: Preop, folder: Path, damage: str) -> None:
    first = cached_model(preop, options=COARSE)
    data = bytearray(entry(first).read_bytes())
    data[len(data) // 2] ^= 1
    damaged = {"byte": bytes(data), "cut": bytes(data[:-100]), "empty": b"", "text": b"hello"}[damage]
    entry(first).write_bytes(damaged)
    again = cached_model(preop, options=COARSE)
    assert not again.was_cached
    assert "model built again (" in again.remark
    assert model_digest(again.model) == model_digest(first.model)
    assert cached_model(preop, options=COARSE).was_cached


def fifo(path: Path, content: bytes) -> None:
    path.unlink()
    os.mkfifo(path)


def link(path: Path, content: bytes) -> None:
    path.unlink()
    path.with_name("elsewhere").write_bytes(content)
    path.with_name("elsewhere").chmod(0o600)
    path.symlink_to(path.with_name("elsewhere"))


def dangling(path: Path, content: bytes) -> None:
    path.unlink()
    path.symlink_to(path.with_name("nowhere"))


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (fifo, "is not a regular file"),
        (link, "symbolic links"),
        (dangling, "symbolic links"),
        (lambda path, _: path.chmod(0o620), "could have been written by another user"),
        (lambda path, _: path.chmod(0o602), "could have been written by another user"),
    ],
)
def test_an_entry_that_is_not_ours_alone_is_replaced(
    preop: Preop, folder: Path, spoil: Callable[[Path, bytes], None], sentence: str
) -> None:
    """A pipe is not waited for, and a link leads nowhere: neither to read nor to write."""
    first = cached_model(preop, options=COARSE)
    path = entry(first)
    spoil(path, path.read_bytes())
    others = {other: other.read_bytes() for other in folder.iterdir() if other.is_file() and other != path}
    again = cached_model(preop, options=COARSE)
    assert not again.was_cached
    assert sentence in again.remark
    assert (again.path, path.is_symlink(), path.stat().st_mode & 0o777) == (path, False, 0o600)
    assert {other: other.read_bytes() for other in folder.iterdir() if other != path} == others
    assert cached_model(preop, options=COARSE).was_cached


def test_a_model_that_another_user_put_there_is_not_used(
    preop: Preop, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = entry(cached_model(preop, options=COARSE))
    owner = path.stat().st_uid
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    again = cached_model(preop, options=COARSE)
    assert not again.was_cached
    assert "could have been written by another user" in again.remark


def test_a_folder_in_the_place_of_an_entry_costs_only_the_cache(preop: Preop, folder: Path) -> None:
    path = entry(cached_model(preop, options=COARSE))
    path.unlink()
    path.mkdir()
    again = cached_model(preop, options=COARSE)
    assert (again.was_cached, again.path) == (False, None)
    assert "is in the way" in again.remark


def test_entries_do_not_depend_on_the_umask(preop: Preop, folder: Path) -> None:
    before = os.umask(0o002)
    try:
        assert not cached_model(preop, options=COARSE).was_cached
        assert cached_model(preop, options=COARSE).was_cached
    finally:
        os.umask(before)


def test_an_entry_of_other_data_is_not_trusted(preop: Preop, folder: Path) -> None:
    mine = cached_model(preop, options=COARSE)
    moved = with_surface(preop, vertices_mm=preop.surfaces[0].vertices_mm + 1.0)
    other = cached_model(moved, options=COARSE)
    entry(mine).write_bytes(entry(other).read_bytes())
    again = cached_model(preop, options=COARSE)
    assert not again.was_cached
    assert "belongs to other data" in again.remark
    assert model_digest(again.model) == model_digest(mine.model)


def test_the_entry_used_longest_ago_goes(preop: Preop, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = []
    for i, knot_mm in enumerate((10.0, 10.5)):
        paths.append(entry(cached_model(preop, options=replace(COARSE, knot_spacing_mm=knot_mm))))
        os.utime(paths[-1], (1000.0 + i, 1000.0 + i))
    assert cached_model(preop, options=COARSE).was_cached  # now the second is the older
    monkeypatch.setattr(model_cache, "MAX_BYTES", int(2.5 * paths[0].stat().st_size))
    third = entry(cached_model(preop, options=replace(COARSE, knot_spacing_mm=11.0)))
    assert sorted(folder.iterdir()) == sorted([paths[0], third])


def test_off_keeps_nothing(preop: Preop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DVF_IG_CACHE", "off")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for _ in range(2):
        found = cached_model(preop, options=COARSE)
        assert (found.was_cached, found.path) == (False, None)
    assert "DVF_IG_CACHE is off" in found.remark
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_costs_only_the_cache(
    preop: Preop, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("DVF_IG_CACHE", str(tmp_path / "file"))
    found = cached_model(preop, options=COARSE)
    assert not found.was_cached
    assert found.remark.startswith("model built, but not stored: cannot make the folder")


def test_where_models_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DVF_IG_CACHE", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert cache_folder() == tmp_path / ".cache" / "dvf_ig" / "models"
    monkeypatch.setenv("XDG_CACHE_HOME", "/elsewhere")
    assert cache_folder() == Path("/elsewhere/dvf_ig/models")
    monkeypatch.setenv("DVF_IG_CACHE", "/given")
    assert cache_folder() == Path("/given/models")


def test_without_a_home_no_folder_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DVF_IG_CACHE", "XDG_CACHE_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)  # this user is in no list of users
    assert cache_folder() is None
