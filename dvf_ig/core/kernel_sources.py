"""Source files from which kernels are inlined, and their digest for caches of compiled code."""

import hashlib
from dataclasses import dataclass
from pathlib import Path


def source_digest(folder: Path) -> str:
    """Compute the SHA-256 (hex) of the names and contents of all Python files in a folder and below it."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\n{len(content)}\n".encode() + content)
    return digest.hexdigest()


@dataclass(frozen=True, slots=True)
class KernelSources:
    """Sources of a folder of kernels, recorded before the first kernel is imported.

    Attributes:
        digest: see `source_digest`.
    """

    folder: Path
    digest: str

    @classmethod
    def of_package(cls, init_file: str) -> "KernelSources":
        """Record the sources of the package with this `__init__.py`; call it there, before any import."""
        folder = Path(init_file).parent
        return cls(folder, source_digest(folder))

    def unchanged(self) -> bool:
        """Return whether the files are unchanged, so that modules imported since agree with them."""
        return source_digest(self.folder) == self.digest
