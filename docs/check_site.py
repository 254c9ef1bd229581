"""Look at the built site in a real browser: ``python docs/check_site.py [out/docs] [--pictures FOLDER]``.

Every page at 390 px and at 1280 px, light and dark: no error on the console, nothing loaded from elsewhere, nothing
that scrolls sideways, text that stands out from its ground; then the search. Links are followed without the browser,
anchors too. Ends in 1 with a line for each fault, and in 5 where there is no browser or no Playwright: then only the
links were looked at, and that is said.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import threading
from functools import partial
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
VIEWS = [(width, scheme) for width in (390, 1280) for scheme in ("light", "dark")]
PICTURED = (
    "index",
    "tutorials/own-plant",
    "reference/api/robust_stability",
    "reference/api/index",
    "reference/cli/mu",
    "theory/mu",
    "gallery",
)
LEAST_CONTRAST = 4.5  # of text, WCAG 2 level AA


class Page(HTMLParser):
    """The anchors and links of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect what can be jumped to, and what is jumped to."""
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.add(value)
            if name in ("href", "src") and value:
                self.links.append(value)


def dead_links(site: Path) -> list[str]:
    """Links within the site that lead nowhere; ``page -> target``."""
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
    """Serves files without a line for each."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


# How text stands out from its ground (WCAG 2): the least of all texts in sight.
CONTRAST = """() => {
  const light = c => { const v = c.map(x => (x /= 255) <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
                       return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const parse = s => (s.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number);
  const ground = e => { for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor);
                          if (c.length < 4 || c[3] === 1) return c; } return [255, 255, 255]; };
  let least = [99, ''];
  const texts = ['p', 'h1', 'h2', 'a', 'code', 'pre span', 'td', 'dt'].map(tag => 'article ' + tag).join();
  for (const e of document.querySelectorAll(texts)) {
    if (!e.textContent.trim() || !e.getClientRects().length) continue;
    const a = light(parse(getComputedStyle(e).color).slice(0, 3)), b = light(ground(e).slice(0, 3));
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < least[0]) least = [ratio, e.tagName + '.' + e.className + ': ' + e.textContent.trim().slice(0, 40)];
  }
  return least;
}"""

# What reaches beyond the right edge of the page and does not scroll in a box of its own.
WIDE = """() => document.documentElement.scrollWidth > innerWidth
  ? [...document.querySelectorAll('article *')].filter(e => e.getBoundingClientRect().right > innerWidth + 1)
      .slice(0, 1).map(e => e.tagName + '.' + e.className + ': ' + e.textContent.trim().slice(0, 40))
      .concat([document.documentElement.scrollWidth + ' px']).join(' ')
  : ''"""


def faults_in_browser(site: Path, program: str, pictures: Path | None) -> list[str]:
    """What a reader would stumble over."""
    from playwright.sync_api import sync_playwright

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    root = f"http://127.0.0.1:{server.server_port}"
    names = [path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html"))]
    found: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program, args=["--no-sandbox"] if os.geteuid() == 0 else []
        )
        for width, scheme in VIEWS:
            context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
            page = context.new_page()
            said: list[str] = []
            page.on("console", lambda m, said=said: said.append(m.text) if m.type in ("error", "warning") else None)
            page.on("pageerror", lambda error, said=said: said.append(str(error)))
            page.on(
                "request",
                lambda r, said=said: (
                    said.append(f"asks for {r.url}") if not r.url.startswith((root, "data:")) else None
                ),
            )
            for name in names:
                said.clear()
                page.goto(f"{root}/{name}")
                where = f"{name} at {width} px, {scheme}"
                found += [f"{where}: {text}" for text in said]
                if wide := page.evaluate(WIDE):
                    found.append(f"{where}: scrolls sideways, {wide}")
                ratio, text = page.evaluate(CONTRAST)
                if ratio < LEAST_CONTRAST:
                    found.append(f"{where}: contrast {ratio:.1f} of {text}")
                if pictures and name.removesuffix(".html") in PICTURED:
                    page.screenshot(
                        path=pictures / f"{name.removesuffix('.html').replace('/', '-')}-{width}-{scheme}.png",
                        full_page=False,
                    )
            context.close()
        page = browser.new_page()
        page.goto(f"{root}/search.html?q=robust_stability")
        try:
            page.wait_for_selector("ul.search li a[href*='robust_stability']", timeout=20_000)
        except Exception as error:  # noqa: BLE001 - the browser's own time-out, of no exported kind
            found.append(f"the search does not find robust_stability: {str(error).splitlines()[0]}")
        if pictures:
            page.screenshot(path=pictures / "search.png")
        browser.close()
    server.shutdown()
    return found


def main() -> int:
    """Check the site; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("site", nargs="?", default="out/docs", type=Path)
    parser.add_argument("--pictures", type=Path, help="folder for screenshots of some pages")
    given = parser.parse_args()
    site = given.site.resolve()
    if not (site / "index.html").exists():
        print(f"{given.site}: no site there; make docs builds it", file=sys.stderr)
        return 3
    faults = [f"dead link: {link}" for link in dead_links(site)]
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    missing = "" if program else f"no browser ({', '.join(BROWSERS)})"
    if program:
        try:
            if given.pictures:
                given.pictures.mkdir(parents=True, exist_ok=True)
            faults += faults_in_browser(site, program, given.pictures)
        except ImportError:
            missing = "no Playwright (pip install playwright)"
    for fault in faults:
        print(fault)
    print(f"{len(faults)} faults" + (f"; {missing}: only links were checked" if missing else ""))
    return 1 if faults else 5 if missing else 0


if __name__ == "__main__":
    sys.exit(main())
