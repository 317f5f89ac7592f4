"""Links of a built site: internal ones must lead to a page and an anchor; external ones are listed."""

from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """Anchors and targets of one page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.targets: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value for name, value in attrs if value}
        self.anchors.update(attributes[name] for name in ("id", "name") if name in attributes)
        if tag == "a" and "href" in attributes:
            self.targets.add(attributes["href"])
        elif tag in ("link", "script", "img"):
            self.loaded.update(attributes[name] for name in ("href", "src") if name in attributes)


def check_site(site: Path) -> tuple[list[str], list[str]]:
    """List broken internal links and anything a page would load from the network; and external targets."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    broken: list[str] = []
    external: set[str] = set()
    for path, page in pages.items():
        name = path.relative_to(site)
        broken += [f"{name} loads {url} from the network" for url in sorted(page.loaded) if _is_remote(url)]
        external.update(url for url in page.targets if _is_remote(url))
        broken += [f"{name}: {reason}" for reason in _unresolved(path, page, pages)]
    return broken, sorted(external)


def _unresolved(path: Path, page: _Page, pages: dict[Path, _Page]) -> Iterator[str]:
    for target in sorted(page.targets):
        if _is_remote(target) or target.startswith(("mailto:", "javascript:")):
            continue
        parts = urlsplit(target)
        goal = (path.parent / unquote(parts.path)).resolve() if parts.path else path
        if goal.is_dir():
            goal /= "index.html"
        if not goal.is_file():
            yield f"link to {target}, which does not exist"
        elif parts.fragment and goal in pages and unquote(parts.fragment) not in pages[goal].anchors:
            yield f"link to {target}, which has no such anchor"


def _is_remote(url: str) -> bool:
    return url.startswith(("http://", "https://", "//"))
