"""The source files that kernels are inlined from, and their digest; for caches of what depends on them."""

import hashlib
from dataclasses import dataclass
from pathlib import Path


def source_digest(folder: Path) -> str:
    """SHA-256 (hex) of the names and contents of all Python files in a folder and below it."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()}\n{len(content)}\n".encode() + content)
    return digest.hexdigest()


@dataclass(frozen=True, slots=True)
class KernelSources:
    """A folder of kernels, as it was before the first of them was imported.

    Attributes:
        digest: see `source_digest`.
    """

    folder: Path
    digest: str

    @classmethod
    def of_package(cls, init_file: str) -> "KernelSources":
        """Sources of the package whose `__init__.py` this is; to be called there, before any is imported."""
        folder = Path(init_file).parent
        return cls(folder, source_digest(folder))

    def unchanged(self) -> bool:
        """Whether the files are still what they were: what was imported since is then what they say."""
        return source_digest(self.folder) == self.digest
