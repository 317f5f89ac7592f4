"""Read and write a surface through the cycle: a mesh file per phase, in a folder or in an archive."""

import lzma
import re
import tarfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dvf_ig.core import CycleTiming, InvalidInputError, SurfaceSeries, UnreadableFileError
from dvf_ig.core.plausible import surface_problem
from dvf_ig.io import limits
from dvf_ig.io.image.timing import read_timing, write_timing
from dvf_ig.io.provenance import record_file
from dvf_ig.io.reading import read_bytes, reading
from dvf_ig.io.writing.atomic import write_bytes
from dvf_ig.io.writing.place import make_folder

from .file import DECODERS, decode_mesh, warn_of_left_out
from .raw import RawMesh
from .vtp import encode_vtp

UNKNOWN_PATIENT = "unknown"
MOST_MEMBERS = 10_000
"""Most meshes in an archive; typical archives have 20 phases of up to ten surfaces."""
_TAR_END = 1 << 20
"""Bytes checked after the last member; an archive is padded with zeros to a multiple of 10 240."""
_CAP = "Cap"
_PHASE_FILE = re.compile(r"(?!\._)(.+?)_?(\d+)\.(obj|stl|ply|vtp)", re.IGNORECASE)
"""File name of a phase; excludes the AppleDouble files ("._…") that macOS adds to archives."""


@dataclass(frozen=True, slots=True)
class _PhaseFile:
    """One mesh file: its displayed path, the parts of its name, and a function that reads it."""

    path: Path
    stem: str
    number: int
    read: Callable[[], bytes]


def read_surface_series(
    folder: Path | str,
    name: str = "EPICARDIAL",
    timing_file: CycleTiming | Path | str | None = None,
    frame: str = "mr",
) -> SurfaceSeries:
    """Read the files `<patient>_<NAME>_<number>.<obj|stl|ply|vtp>` of one surface, in order of their number.

    Names that begin with "._", which macOS adds, are skipped.

    Args:
        folder: holds the files (also in sub-folders), or one tar archive of them, which is read in place.
        name: which surface.
        timing_file: phase times or their file (see `read_timing`); None uses `timing.json` in the folder,
            else phase i is at i/N of an RR of 1.0 s, both marked as assumed.
        frame: name of the meshes' LPS frame.
    Returns:
        the series; the patient id is the prefix of the surface's name, "unknown" without one.
    Raises:
        UnreadableFileError: no such surface (the message lists the others), a phase missing, phases that do
            not share vertices and triangles, or a surface that cannot be in mm.
    """
    folder = Path(folder)
    with reading(folder, "a folder of surfaces"):
        if not folder.is_dir():
            raise FileNotFoundError(folder)
        patient, files = _files_of(folder, _phase_files(folder), name)
        meshes = [decode_mesh(file.path, file.read()) for file in files]
        warn_of_left_out(folder, meshes)
        _require_correspondence(files, meshes)
        timing = (
            timing_file
            if isinstance(timing_file, CycleTiming)
            else read_timing(timing_file, folder=folder, phases=len(files))
        )
        for file, mesh in zip(files, meshes, strict=True):
            if problem := surface_problem(mesh.vertices):
                raise UnreadableFileError(f"{file.path}: the surface {problem}")
        caps = meshes[0].cell_flags.get(_CAP)
        return SurfaceSeries(
            name,
            frame,
            np.stack([mesh.vertices for mesh in meshes]),
            meshes[0].triangles,
            timing,
            patient,
            np.zeros(0, np.bool_) if caps is None else caps.astype(np.bool_),
        )


def surface_names(folder: Path | str) -> list[str]:
    """List the surfaces in a folder or in its archive, without their common prefix (the patient)."""
    folder = Path(folder)
    with reading(folder, "a folder of surfaces"):
        return _surface_names(_phase_files(folder))


def write_surface_series(series: SurfaceSeries, folder: Path | str, *, timing: bool = True) -> None:
    """Write `<NAME>_<phase>.vtp` for each phase (LPS, every digit, caps as cell data) and `timing.json`.

    Raises:
        InvalidInputError: a surface name that is not valid in a file name.
        OutputError: not writable.
    """
    folder = Path(folder)
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9 .+-]*(_[A-Za-z0-9 .+-]+)*", series.name):
        raise InvalidInputError(f"surface name '{series.name}' is not valid in a file name; rename it")
    make_folder(folder)
    for i, vertices in enumerate(series.vertices_mm):
        raw = RawMesh(vertices, series.triangles, "SPACE=LPS", {_CAP: series.caps})
        write_bytes(folder / f"{series.name}_{i:03d}.vtp", encode_vtp(raw))
    if timing:
        write_timing(series.timing, folder / "timing.json")


def _phase_files(folder: Path) -> list[_PhaseFile]:
    """List the numbered mesh files: in the folder, else in its sub-folders, else in its one archive."""
    for paths in (folder.iterdir(), folder.rglob("*")):
        files = [f for path in sorted(paths) if path.is_file() and (f := _on_disk(path))]
        if files:
            return files
    archives = sorted(p for p in folder.iterdir() if p.name.lower().endswith((".tar.gz", ".tgz", ".tar")))
    if len(archives) > 1:
        raise UnreadableFileError(
            f"{folder} has several archives ({', '.join(a.name for a in archives)}); keep one"
        )
    return _in_archive(archives[0]) if archives else []


def _on_disk(path: Path) -> _PhaseFile | None:
    match = _PHASE_FILE.fullmatch(path.name)
    if match is None:
        return None
    return _PhaseFile(path, match[1], int(match[2]), lambda: read_bytes(path, "a triangle mesh"))


def _in_archive(archive: Path) -> list[_PhaseFile]:
    try:
        with tarfile.open(archive, "r:*") as tar:
            contents = _contents(archive, tar)
            _require_end(archive, tar)
    except (tarfile.TarError, EOFError, OSError, zlib.error, lzma.LZMAError) as exc:
        raise UnreadableFileError(f"{archive} is not a readable archive ({exc}); copy it again") from exc
    record_file(archive)
    files = []
    for member, data in sorted(contents.items()):
        match = _PHASE_FILE.fullmatch(Path(member).name)
        if match is not None:
            files.append(_PhaseFile(archive / member, match[1], int(match[2]), _constant(data)))
    return files


def _contents(archive: Path, tar: tarfile.TarFile) -> dict[str, bytes]:
    """Read the mesh files of an archive, at most VOXEL_BYTES together."""
    contents: dict[str, bytes] = {}
    total = 0
    for member in tar:
        if Path(member.name).suffix.lower() not in DECODERS or member.isdir():
            continue
        if not member.isreg():
            raise UnreadableFileError(
                f"{archive}: {member.name} is a link, not a file; pack the files themselves"
            )
        total += member.size
        if total > limits.VOXEL_BYTES or len(contents) >= MOST_MEMBERS:
            raise UnreadableFileError(f"{archive} holds more than meshes of a heart; unpack what is needed")
        stream = tar.extractfile(member)
        contents[member.name] = b"" if stream is None else stream.read()
    return contents


def _require_end(archive: Path, tar: tarfile.TarFile) -> None:
    """Refuse an archive that is truncated after a member, or followed by another: members would be missed."""
    if tar.fileobj is None:
        raise UnreadableFileError(f"{archive} was closed while it was read")
    tar.fileobj.seek(tar.offset)
    end = tar.fileobj.read(_TAR_END)
    if len(end) < tarfile.BLOCKSIZE or end.strip(b"\0"):
        raise UnreadableFileError(f"{archive} has no proper end: it is truncated or damaged; copy it again")


def _constant(data: bytes) -> Callable[[], bytes]:
    return lambda: data


def _files_of(folder: Path, files: list[_PhaseFile], name: str) -> tuple[str, list[_PhaseFile]]:
    """Return the patient and the phases of one surface, in order."""
    chosen = [file for file in files if file.stem == name]
    chosen = chosen or [file for file in files if file.stem.endswith(f"_{name}")]
    if not chosen:
        listed = ", ".join(_surface_names(files)) or "none"
        raise UnreadableFileError(f"{folder} has no surface '{name}'; it has {listed}")
    patients = sorted({file.stem.removesuffix(name).rstrip("_") for file in chosen})
    if len(patients) > 1:
        listed = ", ".join(f"{p}_{name}" for p in patients)
        raise UnreadableFileError(f"{folder}: '{name}' matches several surfaces ({listed}); name one in full")
    chosen.sort(key=lambda file: file.number)
    numbers = [file.number for file in chosen]
    expected = list(range(numbers[0], numbers[0] + len(numbers)))
    if numbers != expected:
        odd = sorted(set(expected) ^ set(numbers)) or sorted({n for n in numbers if numbers.count(n) > 1})
        raise UnreadableFileError(
            f"{folder}: the phases of '{name}' are not consecutive (see number {odd[0]}); rename the files"
        )
    return patients[0] or UNKNOWN_PATIENT, chosen


def _surface_names(files: list[_PhaseFile]) -> list[str]:
    """List the surfaces without the prefix that all of them share (the patient)."""
    stems = sorted({file.stem for file in files})
    parts = [stem.split("_") for stem in stems]
    shared = 0
    while len(stems) > 1 and all(len(p) > shared + 1 and p[shared] == parts[0][shared] for p in parts):
        shared += 1
    return ["_".join(p[shared:]) for p in parts]


def _require_correspondence(files: list[_PhaseFile], meshes: list[RawMesh]) -> None:
    first = meshes[0]
    for file, mesh in zip(files, meshes, strict=True):
        if len(mesh.vertices) != len(first.vertices) or not np.array_equal(mesh.triangles, first.triangles):
            raise UnreadableFileError(
                f"{file.path} has {len(mesh.vertices)} vertices and {len(mesh.triangles)} triangles that do "
                f"not match the {len(first.vertices)} and {len(first.triangles)} of {files[0].path.name}; "
                "needed the same vertices in every phase"
            )
        if not np.array_equal(mesh.cell_flags.get(_CAP, ()), first.cell_flags.get(_CAP, ())):
            raise UnreadableFileError(
                f"{file.path} marks other triangles as caps than {files[0].path.name}; needed the same ones"
            )
