"""What a page holds, read by Python's own parser: is it well-formed, and what does it load."""

from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = {"meta", "img", "br", "hr", "link", "input"}
MAY_STAY_OPEN = {"html", "p", "tr", "td", "th"}
"""HTML closes these by itself."""


@dataclass
class Outline(HTMLParser):
    """Tags, attributes and text of a page."""

    open_tags: list[str] = field(default_factory=list)
    images: list[dict[str, str | None]] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.loaded += [f"{tag} {v}"[:60] for k, v in attrs if k in ("src", "href") and v is not None]
        if tag == "img":
            self.images.append(found)
        if tag not in VOID:
            self.open_tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open_tags and self.open_tags[-1] != tag and self.open_tags[-1] in MAY_STAY_OPEN:
            self.open_tags.pop()
        if not self.open_tags or self.open_tags.pop() != tag:
            self.faults.append(f"</{tag}> closes nothing")

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def outline_of(page: str) -> Outline:
    """The page's outline; its faults are listed, not raised."""
    outline = Outline()
    outline.feed(page)
    outline.close()
    outline.faults += [f"<{tag}> stays open" for tag in outline.open_tags if tag not in MAY_STAY_OPEN]
    return outline
