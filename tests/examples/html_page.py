"""A page of HTML, read back."""

import re
from html.parser import HTMLParser

VOID = {"meta", "br", "img", "link", "input", "hr"}
ADDRESSES = {"src", "href", "data", "action", "srcset", "poster"}


class Page(HTMLParser):
    """A page as tables of cells, addresses and texts; complains of tags that are not closed in order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.addresses, self.tables, self.texts, self.tags = [], [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ADDRESSES]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if "style" in self.open or "script" in self.open:
            return
        self.texts.append(data.strip())
        if {"td", "th"} & set(self.open):
            self.tables[-1][-1][-1] += data.strip()

    def table(self, *head):
        (found,) = [table for table in self.tables if table[0][: len(head)] == list(head)]
        return [dict(zip(found[0], row, strict=True)) for row in found[1:]]

    @property
    def text(self):
        return " ".join(filter(None, self.texts))


def check_self_contained(folder):
    """The report of a folder asks for nothing of the network, and runs no code of others."""
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert len(text) < 3e6
    assert "default-src 'none'" in text
    assert not re.search(r"https?:|//[\w-]+\.|url\(|@import", re.sub(r"base64,[\w+/=]+", "", text))
    assert {"script", "style"} >= {tag for tag in page.tags if tag in ("script", "style", "link", "iframe", "object")}
    for address in page.addresses:
        beside = not re.match(r"[\w+.-]+:|/", address)
        assert address.startswith(("data:image/png;base64,", "data:image/svg+xml;base64,")) or beside
