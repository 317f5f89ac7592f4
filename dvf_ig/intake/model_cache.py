"""Cache of built fixture models: model files named by the SHA-256 of everything they were built from.

The key covers the patient, every array, grid and phase time that the build reads, its options, the source
files of the packages that build, and the versions of their libraries: changing any of them changes the key,
so a stale model is never used. An entry states its key and is a model file with checksums; a damaged or
renamed entry is built again. So is one that another user could have written: an entry must be a regular file
of this user that nobody else may write.

The folder is DVF_IG_CACHE ("off" for none), else dvf_ig within XDG_CACHE_HOME or ~/.cache.
"""

import hashlib
import os
import stat
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import dvf_ig
from dvf_ig.core import AnyArray, DvfModel, Grid, Preop, SurfaceSeries, VolumeSeries
from dvf_ig.core.errors import InvalidInputError, OutputError, UnreadableFileError
from dvf_ig.core.kernel_sources import source_digest
from dvf_ig.io.limits import MODEL_BYTES
from dvf_ig.io.model.model_file import model_bytes, parse_model
from dvf_ig.io.provenance import not_recorded
from dvf_ig.io.writing.atomic import write_own
from dvf_ig.io.writing.place import make_folder

if TYPE_CHECKING:
    from dvf_ig.preop import ModelOptions

MAX_BYTES = 1_000_000_000
"""Most bytes of all entries together; the least recently used are removed. A model of 20 phases has 55 MB."""

ENVIRONMENT = "DVF_IG_CACHE"
SUFFIX = ".dvf-model"
BUILT_BY = ("core", "kernels", "preop")
"""Packages of this project that determine the model."""
LIBRARIES = ("numpy", "scipy", "scikit-image", "numba")

_MAGIC = b"dvf_ig cached model "
_HEADER_BYTES = len(_MAGIC) + 64 + 1


@dataclass(frozen=True, slots=True, eq=False)
class CachedModel:
    """A model and its origin.

    Attributes:
        was_cached: it was read, not built.
        path: its entry; None if there is none.
        remark: one sentence for the user.
    """

    model: DvfModel
    was_cached: bool
    path: Path | None
    remark: str


def cached_model(
    preop: Preop, *, options: "ModelOptions | None" = None, progress: Callable[[float], None] | None = None
) -> CachedModel:
    """Return the patient's model from the cache, or build and store it.

    Args:
        options: of the build; None for the defaults.
        progress: called with the fraction of the build that is done.
    Raises:
        InvalidInputError: the model cannot be built (see `model_from_preop`).
    """
    from dvf_ig.preop import ModelOptions, model_from_preop

    options = options or ModelOptions()
    folder = cache_folder()
    if folder is None:
        model = model_from_preop(preop, options=options, progress=progress)
        remark = f"model built, but not stored: {ENVIRONMENT} is off, or unset and there is no home folder"
        return CachedModel(model, False, None, remark)
    key = model_key(preop, options)
    path = folder / f"{key}{SUFFIX}"
    why = "model built"
    if os.path.lexists(path):
        try:
            with not_recorded():
                model = _read(path, key, preop.patient_id)
        except (UnreadableFileError, InvalidInputError) as error:
            why = f"model built again ({error})"
            with suppress(OSError):
                path.unlink()  # a link would lead the new entry elsewhere
        else:
            with suppress(OSError):
                os.utime(path, follow_symlinks=False)
            return CachedModel(model, True, path, f"model from the cache: {path}")
    model = model_from_preop(preop, options=options, progress=progress)
    try:
        _write(path, key, model)
    except OutputError as error:
        return CachedModel(model, False, None, f"{why}, but not stored: {error}")
    _remove_oldest(folder, path)
    return CachedModel(model, False, path, f"{why} and stored in {path}")


def cache_folder() -> Path | None:
    """Return the folder of cached models; None if the cache is off or there is no home folder."""
    chosen = os.environ.get(ENVIRONMENT, "")
    if chosen.lower() == "off":
        return None
    if chosen:
        return Path(chosen).expanduser() / "models"
    base = os.environ.get("XDG_CACHE_HOME", "") or os.path.expanduser("~/.cache")
    return Path(base) / "dvf_ig" / "models" if os.path.isabs(base) else None


def cache_entries() -> dict[Path, int]:
    """List the files of the cached models, with their sizes in bytes."""
    folder = cache_folder()
    paths = () if folder is None else folder.glob(f"*{SUFFIX}")
    return {path: path.lstat().st_size for path in paths}


def clear_cache() -> int:
    """Remove every cached model, and return their number.

    Raises:
        OutputError: an entry cannot be removed.
    """
    entries = cache_entries()
    for path in entries:
        try:
            path.unlink(missing_ok=True)
        except OSError as exc:
            raise OutputError(f"cannot remove {path}: {exc.strerror or exc}") from exc
    return len(entries)


def model_key(preop: Preop, options: "ModelOptions") -> str:
    """Hash (SHA-256, hex) everything that the model of these data with these options depends on."""
    digest = hashlib.sha256()
    _add(digest, "program", _program())
    settings = {name: value for name, value in asdict(options).items() if name != "threads"}
    _add(digest, "options", settings)
    _add(digest, "patient", (preop.patient_id, preop.surface))
    if preop.labels is None and preop.ed_labels is None:
        for series in preop.surfaces:
            _add_surface(digest, series)
        return digest.hexdigest()
    _add(digest, "labels", (preop.label_names, preop.organ_labels, preop.cavity_labels))
    if preop.labels is not None:
        _add_image(digest, preop.labels)
    elif preop.ed_labels is not None and preop.mr is not None:
        _add_image(digest, preop.mr)
        _add(digest, "end-diastole", preop.ed_phase)
        _add_array(digest, "end-diastolic labels", preop.ed_labels.values)
        _add_grid(digest, preop.ed_labels.grid)
        for view in preop.views:
            _add_image(digest, view)
    return digest.hexdigest()


def _add_image(digest: Any, image: VolumeSeries) -> None:
    timing = image.timing
    _add(digest, "timing", (timing.rr_s, timing.rr_assumed, timing.timing_assumed))
    _add_grid(digest, image.grid)
    _add_array(digest, "fractions", timing.fractions)
    _add_array(digest, "values", image.values)


def _add_grid(digest: Any, grid: Grid) -> None:
    _add(digest, "grid", (grid.frame, grid.shape))
    for name, array in (
        ("origin", grid.origin_mm),
        ("spacing", grid.spacing_mm),
        ("direction", grid.direction),
    ):
        _add_array(digest, name, array)


def _add_surface(digest: Any, series: SurfaceSeries) -> None:
    timing = series.timing
    _add(digest, "surface", (series.name, series.frame, series.patient_id))
    _add(digest, "timing", (timing.rr_s, timing.rr_assumed, timing.timing_assumed))
    for name, array in (
        ("fractions", timing.fractions),
        ("vertices", series.vertices_mm),
        ("triangles", series.triangles),
        ("caps", series.caps),
    ):
        _add_array(digest, name, array)


def _add(digest: Any, name: str, value: object) -> None:
    digest.update(f"\n{name} {value!r}\n".encode())


def _add_array(digest: Any, name: str, array: AnyArray) -> None:
    _add(digest, name, (array.dtype.str, array.shape))
    digest.update(np.ascontiguousarray(array).data)


@cache
def _program() -> tuple[str, ...]:
    """List the versions of the libraries, and the digests of the source files that build a model."""
    digests = (source_digest(Path(dvf_ig.__file__).parent / package) for package in BUILT_BY)
    libraries = tuple(f"{name} {version(name)}" for name in LIBRARIES)
    return (dvf_ig.__version__, *digests, *libraries)


def _write(path: Path, key: str, model: DvfModel) -> None:
    """Write an entry that only this user may change, whatever the umask."""
    make_folder(path.parent)
    if os.path.lexists(path) and (path.is_symlink() or not path.is_file()):
        raise OutputError(f"{path} is in the way, and cannot be removed")
    write_own(path, [_MAGIC + key.encode("ascii") + b"\n", *model_bytes(model)])
    try:
        path.chmod(0o600)
    except OSError as exc:
        raise OutputError(f"cannot set the permissions of {path}: {exc.strerror or exc}") from exc


def _own_bytes(path: Path) -> bytes:
    """Read a regular file of this user without blocking or following links.

    Raises:
        UnreadableFileError: not a regular file, or a file that another user owns or may write.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
        with open(descriptor, "rb") as stream:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise UnreadableFileError(f"{path} is not a regular file")
            if status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                raise UnreadableFileError(f"{path} could have been written by another user")
            if status.st_size > MODEL_BYTES:
                raise UnreadableFileError(
                    f"{path} has {status.st_size} bytes; at most {MODEL_BYTES} can be read"
                )
            return stream.read(status.st_size)
    except OSError as exc:
        raise UnreadableFileError(f"cannot read {path} as a cached model: {exc.strerror or exc}") from exc


def _read(path: Path, key: str, patient_id: str) -> DvfModel:
    """Read the model of an entry that was written for this key."""
    data = _own_bytes(path)
    if data[:_HEADER_BYTES] != _MAGIC + key.encode("ascii") + b"\n":
        raise UnreadableFileError(f"{path} is damaged or belongs to other data")
    model = parse_model(data[_HEADER_BYTES:], path)
    if model.patient_id != patient_id:
        raise UnreadableFileError(f"{path} is the model of patient '{model.patient_id}'")
    return model


def _remove_oldest(folder: Path, newest: Path) -> None:
    """Remove the least recently used entries until MAX_BYTES remain, but never the newest."""
    with suppress(OSError):
        entries = sorted(
            (path.lstat().st_mtime, path) for path in folder.glob(f"*{SUFFIX}") if path != newest
        )
        total = newest.stat().st_size + sum(path.lstat().st_size for _, path in entries)
        for _, path in entries:
            if total <= MAX_BYTES:
                return
            total -= path.lstat().st_size
            path.unlink()
