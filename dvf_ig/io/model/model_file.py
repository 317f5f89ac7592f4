"""Read and write DvfModel files: one `.npz` without pickle, a JSON header, and checksums."""

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import AnyArray, CycleTiming, DvfModel, Mesh, SeenPart, UnreadableFileError
from dvf_ig.io.limits import MODEL_BYTES
from dvf_ig.io.npz import read_npz, require_npz_sizes
from dvf_ig.io.reading import read_bytes, reading
from dvf_ig.io.writing.atomic import write_bytes
from dvf_ig.io.yaml_config import validated

from .header import (
    SCHEMA_OF_PART,
    SEEN_ARRAYS,
    ModelHeader,
    chamber_arrays,
    chambers_of_arrays,
    require_consistent,
    tissue_of_arrays,
    tissue_parts,
)

SCHEMA = "dvf_ig.model/1"
_CHECKSUM = b"dvf_ig sha256 "
_CHECKSUM_BYTES = len(_CHECKSUM) + 64


def write_model(model: DvfModel, path: Path | str) -> None:
    """Write a model as one `.npz`.

    The header holds schema, units, frame, phase times, RR with its assumed flags, patient id, sources and
    the SHA-256 over header and arrays; the zip comment holds a checksum of the whole file.

    Raises:
        OutputError: not writable.
    """
    write_bytes(Path(path), model_bytes(model))


def model_bytes(model: DvfModel) -> list[bytes]:
    """Return the blocks that `write_model` writes."""
    header, arrays = _parts(model)
    header["sha256"] = _digest(header, arrays)
    buffer = io.BytesIO()
    text = json.dumps(header, sort_keys=True, ensure_ascii=False, indent=1)
    np.savez(buffer, **{"header": np.frombuffer(text.encode("utf-8"), np.uint8), **arrays})  # type: ignore[arg-type]
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.comment = _CHECKSUM + b"0" * 64
    body = buffer.getvalue()[:-64]
    return [body, hashlib.sha256(body).hexdigest().encode("ascii")]


def read_model(path: Path | str, patient_id: str | None = None) -> DvfModel:
    """Read a model and verify it.

    Args:
        path: file written by `write_model`.
        patient_id: the patient whose model is needed; None accepts any.
    Raises:
        UnreadableFileError: absent, not a model, another schema, or any byte changed since it was written.
        InvalidInputError: the model of another patient.
    """
    path = Path(path)
    with reading(path, "a model file"):
        _require_ends(path)
    model = parse_model(read_bytes(path, "a model file"), path)
    if patient_id is not None:
        model.require_patient(patient_id, f"{path} is the model")
    return model


def parse_model(data: bytes, path: Path) -> DvfModel:
    """Verify and unpack the bytes of a model file; `path` is named in errors.

    Raises:
        UnreadableFileError: as `read_model`.
    """
    _check_checksum(path, data)
    with reading(path, "a model file"):
        header, arrays = _unpack(path, data)
        if header.get("schema") not in (SCHEMA, SCHEMA_OF_PART):
            raise UnreadableFileError(
                f"{path} has schema '{header.get('schema')}'; this version reads '{SCHEMA}' and "
                f"'{SCHEMA_OF_PART}': build it again"
            )
        stated = header.pop("sha256", None)
        if stated != _digest(header, arrays):
            raise UnreadableFileError(
                f"{path} was changed after it was written (SHA-256 differs); build it again"
            )
        return _model(path, header, arrays)


def model_digest(model: DvfModel) -> str:
    """Hash (SHA-256, hex) the model's header and arrays: equal for equal models."""
    return _digest(*_parts(model))


def _parts(model: DvfModel) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    header = {
        "schema": SCHEMA if model.seen is None else SCHEMA_OF_PART,
        "units": {"length": "mm", "time": "s", "coefficients": "mm"},
        "distance_sign": "positive inside the protected organ",
        "axes": "LPS",
        "frame": model.frame,
        "patient_id": model.patient_id,
        "surface_name": model.surface_name,
        "phases": model.phases,
        "rr_s": model.timing.rr_s,
        "rr_assumed": model.timing.rr_assumed,
        "timing_assumed": model.timing.timing_assumed,
        "es_fraction": float(model.es_fraction),
        "ed_phase": int(model.ed_phase),
        "knot_spacing_mm": float(model.knot_spacing_mm),
        "sources": list(model.sources),
    }
    arrays: dict[str, AnyArray] = {
        "fractions": model.timing.fractions,
        "coefficients": model.coefficients,
        "origin_mm": model.origin_mm,
        "reference_vertices_mm": np.concatenate([m.vertices_mm for m in model.reference]),
        "reference_triangles": np.concatenate([m.triangles for m in model.reference]).astype(np.int32),
        "reference_caps": np.concatenate(model.reference_caps),
        "vertex_counts": np.array([len(m.vertices_mm) for m in model.reference], dtype=np.int64),
        "triangle_counts": np.array([len(m.triangles) for m in model.reference], dtype=np.int64),
    }
    if model.cine_fingerprint is not None:
        header["cine_fingerprint"] = model.cine_fingerprint
    if model.seen is not None:
        arrays |= {name: getattr(model.seen, name[5:]) for name in SEEN_ARRAYS}
    if model.tissue is not None:
        header["tissue"], of_tissue = tissue_parts(model.tissue)
        arrays |= of_tissue
    if model.chambers:
        header["chambers"] = [chamber.name for chamber in model.chambers]
        arrays |= chamber_arrays(model.chambers)
    return header, arrays


def _digest(header: dict[str, Any], arrays: dict[str, AnyArray]) -> str:
    text = json.dumps(header, sort_keys=True, ensure_ascii=False)
    digest = hashlib.sha256(text.encode("utf-8"))
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        little = array.astype(array.dtype.newbyteorder("<"), copy=False)
        digest.update(f"\n{name} {little.dtype.str} {little.shape}\n".encode("ascii"))
        digest.update(little.data)
    return digest.hexdigest()


def _require_ends(path: Path) -> None:
    """Refuse, before the whole file is read, one that does not begin or end like a model, or is too large."""
    if not path.is_file():
        return  # a pipe has no size; its content is checked as a whole
    size = path.stat().st_size
    with path.open("rb") as stream:
        begin = stream.read(2)
        stream.seek(max(size - _CHECKSUM_BYTES, 0))
        end = stream.read(_CHECKSUM_BYTES)
    if begin != b"PK":
        raise UnreadableFileError(f"{path} is not a model file; build one with: dvf-ig model build")
    if not end.startswith(_CHECKSUM):
        raise _damaged(path, size)
    try:
        require_npz_sizes(path, MODEL_BYTES)
    except UnreadableFileError as exc:
        raise UnreadableFileError(
            f"{path} is not an intact model file ({exc.message}); build it again"
        ) from exc


def _check_checksum(path: Path, data: bytes) -> None:
    """Refuse files that are not model files, and model files with any changed byte."""
    if not data.startswith(b"PK"):
        raise UnreadableFileError(f"{path} is not a model file; build one with: dvf-ig model build")
    body, stated = data[:-64], data[-64:]
    has_checksum = data[-_CHECKSUM_BYTES:-64] == _CHECKSUM
    if not has_checksum or hashlib.sha256(body).hexdigest().encode("ascii") != stated:
        raise _damaged(path, len(data))


def _damaged(path: Path, size: int) -> UnreadableFileError:
    return UnreadableFileError(
        f"{path} is not an intact model file ({size} bytes, its checksum does not match): "
        "it was truncated, changed, or not written by dvf-ig; build it again"
    )


def _unpack(path: Path, data: bytes) -> tuple[dict[str, Any], dict[str, AnyArray]]:
    try:
        arrays = read_npz(path, data, MODEL_BYTES)
        header = json.loads(arrays.pop("header").tobytes())
    except (ValueError, KeyError, RecursionError) as exc:
        raise UnreadableFileError(f"{path} is not a model file ({exc}); build it again") from exc
    if not isinstance(header, dict):
        raise UnreadableFileError(
            f"{path} is not a model file: its header is not a JSON object; build it again"
        )
    return header, arrays


def _model(path: Path, document: dict[str, Any], arrays: dict[str, AnyArray]) -> DvfModel:
    header = validated(ModelHeader, document, path)
    try:
        require_consistent(header, arrays)
        vertices = np.split(arrays["reference_vertices_mm"], np.cumsum(arrays["vertex_counts"])[:-1])
        triangles = np.split(arrays["reference_triangles"], np.cumsum(arrays["triangle_counts"])[:-1])
        caps = np.split(arrays["reference_caps"], np.cumsum(arrays["triangle_counts"])[:-1])
        frame = header.frame
        return DvfModel(
            patient_id=header.patient_id,
            surface_name=header.surface_name,
            frame=frame,
            timing=CycleTiming(arrays["fractions"], header.rr_s, header.rr_assumed, header.timing_assumed),
            es_fraction=header.es_fraction,
            ed_phase=header.ed_phase,
            coefficients=arrays["coefficients"],
            origin_mm=arrays["origin_mm"],
            knot_spacing_mm=header.knot_spacing_mm,
            reference=tuple(Mesh(frame, v, t) for v, t in zip(vertices, triangles, strict=True)),
            reference_caps=tuple(caps),
            sources=header.sources,
            chambers=chambers_of_arrays(header.chambers, frame, arrays),
            cine_fingerprint=header.cine_fingerprint,
            seen=_seen(header, arrays),
            tissue=tissue_of_arrays(header, arrays),
        )
    except KeyError as exc:
        raise UnreadableFileError(f"{path}: the model lacks {exc}; build it again") from exc


def _seen(header: ModelHeader, arrays: dict[str, AnyArray]) -> SeenPart | None:
    if header.schema_ != SCHEMA_OF_PART:
        return None
    return SeenPart(**{name[5:]: arrays[name] for name in SEEN_ARRAYS})
