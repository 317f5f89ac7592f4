"""Build the site with Sphinx from a copy of `dvf_ig/docs`: nothing is generated next to the sources."""

import shutil
import subprocess
import sys
from pathlib import Path

from links import check_site

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SITE = ROOT / "out" / "docs"


def main() -> int:
    """Build the site, check its links and print its location."""
    source = ROOT / "out" / "docs-source"
    for folder in (source, SITE):
        shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "dvf_ig" / "docs", source)
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    (source / "changelog.md").write_text(changes.replace("](dvf_ig/docs/", "]("), encoding="utf-8")
    options = ["-W", "--keep-going", "-q", "-j", "auto", "-b", "html", "-c", str(HERE)]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, "-d", str(source / ".doctrees"), str(source), str(SITE)],
        check=False,
    )
    if built.returncode:
        return built.returncode
    shutil.rmtree(source)
    broken, external = check_site(SITE)
    for line in broken:
        print(f"docs: {line}", file=sys.stderr)
    (SITE / "external-links.txt").write_text("\n".join(external) + "\n", encoding="utf-8")
    pages = sum(1 for _ in SITE.rglob("*.html"))
    print(f"{SITE / 'index.html'}: {pages} pages, {len(broken)} broken links, {len(external)} external ones")
    return 1 if broken else 0


if __name__ == "__main__":
    raise SystemExit(main())
