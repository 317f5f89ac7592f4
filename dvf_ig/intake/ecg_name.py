"""An ECG's name taken apart: its format, its file, and the field in it."""

from dataclasses import dataclass

from dvf_ig.io.ecg.recording import KINDS
from dvf_ig.io.ecg.trigger import TRIGGER_PREFIX


@dataclass(frozen=True, slots=True)
class EcgName:
    """`plus:sweep.igs.mha#EcgData` as its format, its file, and the field in it."""

    prefix: str
    name: str
    field: str


def split_ecg(spec: str) -> EcgName:
    """What names an ECG or a trigger, in parts; prefix and field are empty where they are not given."""
    kind, colon, rest = spec.partition(":")
    if not colon or f"{kind}:" not in (*(f"{k}:" for k in KINDS), TRIGGER_PREFIX):
        kind, colon, rest = "", "", spec
    name, at, field = rest.partition("#")
    return EcgName(kind + colon, name, at + field)
