"""Check the built site in a browser: ``python docs/check_site.py [out/docs] [--pictures FOLDER]``.

Every page at 390 px and 1280 px, light and dark: no console error, no external request, no sideways scrolling, enough
contrast; then the search. Links and anchors are checked without the browser. Exit code 1 with a line for each fault, 5
without a browser or Playwright: then only the links were checked.
"""

from __future__ import annotations

import argparse
import sys
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

from browser import VIEWS, faults_in_sight, missing, opened, page_in

PICTURED = (
    "index",
    "tutorials/own-plant",
    "reference/api/robust_stability",
    "reference/api/index",
    "reference/cli/mu",
    "theory/mu",
    "gallery",
)


class Page(HTMLParser):
    """Anchors and links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect anchors and link targets."""
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            if name in ("href", "src") and value:
                self.links.append(value)


def dead_links(site: Path) -> list[str]:
    """Return broken links within the site as ``page -> target``."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    dead = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if target.is_dir():
                target /= "index.html"
            there = target.exists() and (
                not parts.fragment or target not in pages or unquote(parts.fragment) in pages[target].anchors
            )
            if not there:
                dead.append(f"{path.relative_to(site)} -> {link}")
    return dead


class Quiet(SimpleHTTPRequestHandler):
    """Serve files without logging."""

    def log_message(self, *_: object) -> None:
        """Do not log."""


def faults_in_browser(site: Path, pictures: Path | None) -> list[str]:
    """Return the faults of the site."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    root = f"http://127.0.0.1:{server.server_port}"
    names = [path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html"))]
    found: list[str] = []
    with opened() as browser:
        for width, scheme in VIEWS:
            with page_in(browser, root, width, scheme) as (page, messages):
                for name in names:
                    messages.clear()
                    page.goto(f"{root}/{name}")
                    where = f"{name} at {width} px, {scheme}"
                    found += [f"{where}: {text}" for text in [*messages, *faults_in_sight(page, "article")]]
                    if pictures and name.removesuffix(".html") in PICTURED:
                        page.screenshot(
                            path=pictures / f"{name.removesuffix('.html').replace('/', '-')}-{width}-{scheme}.png",
                            full_page=False,
                        )
        page = browser.new_page()
        page.goto(f"{root}/search.html?q=robust_stability")
        try:
            page.wait_for_selector("ul.search li a[href*='robust_stability']", timeout=20_000)
        except Exception as error:  # noqa: BLE001 - the browser's own time-out, of no exported kind
            found.append(f"the search does not find robust_stability: {str(error).splitlines()[0]}")
        if pictures:
            page.screenshot(path=pictures / "search.png")
    server.shutdown()
    return found


def main() -> int:
    """Check the site and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", nargs="?", default="out/docs", type=Path)
    parser.add_argument("--pictures", type=Path, help="folder for screenshots of some pages")
    given = parser.parse_args()
    site = given.site.resolve()
    if not (site / "index.html").exists():
        print(f"{given.site}: no site there; make docs builds it", file=sys.stderr)
        return 3
    faults = [f"dead link: {link}" for link in dead_links(site)]
    reason = missing()
    if not reason:
        if given.pictures:
            given.pictures.mkdir(parents=True, exist_ok=True)
        faults += faults_in_browser(site, given.pictures)
    for fault in faults:
        print(fault)
    print(f"{len(faults)} faults" + (f"; {reason}: only links were checked" if reason else ""))
    return 1 if faults else 5 if reason else 0


if __name__ == "__main__":
    sys.exit(main())
