"""No reader writes, moves or removes anything, whatever lies beside the file that it reads."""

import os
import subprocess
import sys
from pathlib import Path

AUDITED = """
import json, os, sys, tempfile
from pathlib import Path
from scripts.fuzz_readers import READERS, write_seeds

folder = Path(sys.argv[1]).resolve()
write_seeds(folder)
victim = folder.parent / "victim" / ".0badcafe"
victim.mkdir(parents=True)
said = {"folder": "../victim/.0badcafe", "moves": {}, "files": {}, "unfinished": ["r.dat"]}
for place in [folder, *(p for p in folder.rglob("*") if p.is_dir())]:
    for name in (".dvf_ig_swap.json", ".written_by_dvf_ig.json"):
        (place / name).write_text(json.dumps(said))
    os.chmod(place, 0o555)

CHANGES = "rename remove rmdir mkdir truncate link symlink chmod chown utime".split()
CHANGES = [*(f"os.{name}" for name in CHANGES), "shutil.rmtree", "shutil.move"]
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
OWN = os.path.join(tempfile.gettempdir(), "dvf_ig_")
found = []

def watch(event, args):
    if event in CHANGES or (event == "open" and isinstance(args[2], int) and args[2] & WRITES):
        path = os.fsdecode(args[0]) if isinstance(args[0], (str, bytes, os.PathLike)) else str(args[0])
        folder_fd = args[-1] if event in ("os.remove", "os.rmdir", "os.mkdir") else -1
        if isinstance(folder_fd, int) and folder_fd >= 0:
            path = os.path.join(os.readlink(f"/proc/self/fd/{folder_fd}"), path)
        if not path.startswith(OWN) and "__pycache__" not in path and path != "/dev/null":
            found.append((event, path))
            raise PermissionError(13, "no reader writes", path)

sys.addaudithook(watch)
for name, (files, read) in READERS.items():
    for file in files:
        read(folder / file)
print(json.dumps({"readers": len(READERS), "found": found, "victim": victim.is_dir()}))
"""


def test_no_reader_writes(tmp_path: Path) -> None:
    root = Path(__file__).parents[2]
    command = [sys.executable, "-c", AUDITED, str(tmp_path / "files")]
    (tmp_path / "files").mkdir()
    environment = {**os.environ, "PYTHONPATH": f"{root}{os.pathsep}{root / 'tests' / 'toys'}"}
    done = subprocess.run(
        command, cwd=root, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.strip().endswith('"found": [], "victim": true}')
