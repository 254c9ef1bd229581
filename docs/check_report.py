"""Check reports of runs in a browser: ``python docs/check_report.py report.html ... [--pictures FOLDER]``.

Each page is opened from its file: at 390 px and 1280 px, light and dark; with every figure opened and zoomed; without
scripts; and printed. Exit code 1 with a line for each fault, 5 without a browser or Playwright: then nothing was
checked.
"""

from __future__ import annotations

import argparse
import re
import sys
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path
from typing import Any
from unicodedata import normalize

from browser import VIEWS, faults_in_sight, missing, opened, page_in

LARGEST = 3_000_000  # bytes
DARK, LIGHT = 80, 200  # of 255: the median of a picture on a dark and on a light ground
SMALLEST_TEXT = 13  # px, in the table of requirements on a telephone
ID = re.compile(r"(\d+\. )?\w+([-_.]\w+)+")

# Cells of the table of requirements that cannot be read: beyond the edge, clipped, or too small.
UNREADABLE = """smallest => [...document.querySelectorAll('table.requirements td')].filter(e => {
  const box = e.getBoundingClientRect();
  return box.left < 0 || box.right > innerWidth || e.scrollWidth > e.clientWidth + 1
    || parseFloat(getComputedStyle(e).fontSize) < smallest;
}).map(e => e.textContent.trim().slice(0, 60))"""

# A word in the top and one in the bottom corner of each figure: where both are on one page, the figure is not cut.
MARKED = """() => document.querySelectorAll('figure').forEach((figure, k) => {
  figure.style.position = 'relative';
  for (const side of ['top', 'bottom']) {
    const mark = document.createElement('span');
    mark.textContent = 'figure' + k + side;
    mark.style.cssText = 'position:absolute;left:0;font-size:6px;line-height:1;' + side + ':0';
    figure.append(mark);
  }
})"""


class Tags(HTMLParser):
    """Collect the tags of a page, duplicate names and tags closed in the wrong order."""

    VOID = ("meta", "br", "img")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.faults: list[str] = []
        self._open: list[str] = []
        self._names: set[str] = set()
        self.feed(text)
        self.faults += [f"<{tag}> is never closed" for tag in self._open]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Store the tag; report a duplicate name."""
        self.tags.append(tag)
        if tag not in self.VOID:
            self._open.append(tag)
        name = dict(attrs).get("id")
        if name is not None and name in self._names:
            self.faults.append(f"id {name!r} comes twice")
        self._names.add(name or "")

    def handle_endtag(self, tag: str) -> None:
        """Report a tag that is closed but was not the last one opened."""
        if not self._open or self._open.pop() != tag:
            self.faults.append(f"</{tag}> at {self.getpos()} closes something else")


def faults_of(report: Path, browser: Any, pictures: Path | None) -> list[str]:
    """Return the faults of one report."""
    address, text = report.resolve().as_uri(), report.read_text(encoding="utf-8")
    found = Tags(text).faults
    if report.stat().st_size > LARGEST:
        found.append(f"{report.stat().st_size} bytes, {LARGEST} are allowed")
    for width, scheme in VIEWS:
        with page_in(browser, address, width, scheme) as (page, messages):
            page.goto(address)
            where = f"at {width} px, {scheme}: "
            page.screenshot(path=_named(pictures, report, f"{width}-{scheme}"))
            faults = faults_in_sight(page, "body")
            faults += [f"cannot be read: {cell}" for cell in page.evaluate(UNREADABLE, SMALLEST_TEXT)]
            faults += _brightness_of_pictures(page, scheme)
            faults += faults_in_sight(page, "body") + messages
            found += [where + fault for fault in faults]
    return found + _without_scripts(browser, address, text) + _printed(browser, address, report, pictures)


def _named(pictures: Path | None, report: Path, what: str) -> Path | None:
    return pictures / f"{report.parent.name}-{what}.png" if pictures else None


def _brightness(picture: bytes) -> float:
    from matplotlib.image import imread
    from numpy import median

    return float(median(imread(BytesIO(picture))[..., :3])) * 255


def _brightness_of_pictures(page: Any, scheme: str) -> list[str]:
    """Return pictures that are bright on a dark page, or dark on a bright one."""
    found = []
    for figure in page.query_selector_all("figure"):
        shown = _brightness(figure.query_selector("img").screenshot())
        if (shown > DARK) if scheme == "dark" else (shown < LIGHT):
            found.append(f"{figure.get_attribute('id')}: the picture's brightness is {shown:.0f} of 255")
    return found


def _without_scripts(browser: Any, address: str, text: str) -> list[str]:
    """Check that pictures exist, tags are well formed, and headings and captions are words."""
    with page_in(browser, address, java_script_enabled=False) as (page, messages):
        page.goto(address)
        found = list(messages)
        if page.query_selector_all("button"):
            found.append("there are buttons that do nothing")
        lacking = page.eval_on_selector_all(
            "figure img", "all => all.filter(e => !e.naturalWidth || !e.offsetHeight).length"
        )
        if lacking:
            found.append(f"{lacking} pictures are not shown")
        read = page.eval_on_selector_all("*", "all => all.map(e => e.localName)")
        written = Tags(text).tags
        if read != written:
            first = next((k for k, pair in enumerate(zip(read, written, strict=False)) if len(set(pair)) > 1), -1)
            found.append(f"the browser mends the tags: element {first} of {len(written)} (it makes {len(read)})")
        words = page.eval_on_selector_all("h1, h2, figcaption, nav a, dt", "all => all.map(e => e.textContent.trim())")
        found += [f"an id instead of words: {word!r}" for word in words if not word or ID.fullmatch(word)]
    return [f"without scripts: {fault}" for fault in found]


def _printed(browser: Any, address: str, report: Path, pictures: Path | None) -> list[str]:
    """Check the printed report: the title comes first, no page is empty, no figure is cut."""
    from pypdf import PdfReader

    with page_in(browser, address) as (page, _):
        page.goto(address)
        title, figures = page.inner_text("h1"), len(page.query_selector_all("figure"))
        page.evaluate(MARKED)
        paper = page.pdf(prefer_css_page_size=True)
    if pictures:
        (pictures / f"{report.parent.name}.pdf").write_bytes(paper)
    sheets = [normalize("NFKC", sheet.extract_text()) for sheet in PdfReader(BytesIO(paper)).pages]  # fi as two letters
    texts = ["".join(sheet.split()) for sheet in sheets]
    found = [] if "".join(title.split()) in texts[0] else [f"the first page does not begin with {title!r}"]
    found += [f"page {k} of {len(texts)} is empty" for k, text in enumerate(texts, 1) if not text]
    whole = [any(f"figure{k}top" in text and f"figure{k}bottom" in text for text in texts) for k in range(figures)]
    found += [f"figure {k + 1} is cut by the end of a page" for k, is_whole in enumerate(whole) if not is_whole]
    return [f"on paper: {fault}" for fault in found]


def main() -> int:
    """Check the reports and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reports", nargs="+", type=Path)
    parser.add_argument("--pictures", type=Path, help="folder for screenshots and the printed pages")
    given = parser.parse_args()
    gone = [report for report in given.reports if not report.is_file()]
    if gone:
        print(f"{gone[0]}: no such file; robustlab run writes it", file=sys.stderr)
        return 3
    if reason := missing():
        print(f"nothing was looked at: {reason}")
        return 5
    if given.pictures:
        given.pictures.mkdir(parents=True, exist_ok=True)
    count = 0
    with opened() as browser:
        for report in given.reports:
            faults = faults_of(report, browser, given.pictures)
            count += len(faults)
            for fault in faults:
                print(f"{report}: {fault}")
    print(f"{count} faults in {len(given.reports)} reports")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
