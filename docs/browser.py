"""Open pages in an installed browser and check layout and contrast, for `check_site` and `check_report`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
VIEWS = [(width, scheme) for width in (390, 1280) for scheme in ("light", "dark")]
LEAST_CONTRAST = 4.5  # of text, WCAG 2 level AA

# Contrast of text and background (WCAG 2): the smallest of all visible texts.
CONTRAST = """scope => {
  const light = c => { const v = c.map(x => (x /= 255) <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
                       return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const parse = s => (s.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number);
  const ground = e => { for (; e; e = e.parentElement) { const c = parse(getComputedStyle(e).backgroundColor);
                          if (c.length < 4 || c[3] === 1) return c; } return [255, 255, 255]; };
  let least = [99, ''];
  const texts = ['p', 'h1', 'h2', 'a', 'code', 'pre span', 'td', 'dt'].map(tag => scope + ' ' + tag).join();
  for (const e of document.querySelectorAll(texts)) {
    if (!e.textContent.trim() || !e.getClientRects().length) continue;
    const a = light(parse(getComputedStyle(e).color).slice(0, 3)), b = light(ground(e).slice(0, 3));
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < least[0]) least = [ratio, e.tagName + '.' + e.className + ': ' + e.textContent.trim().slice(0, 40)];
  }
  return least;
}"""

# Elements beyond the right edge of the page that do not scroll in a box.
WIDE = """scope => document.documentElement.scrollWidth > innerWidth
  ? [...document.querySelectorAll(scope + ' *')].filter(e => e.getBoundingClientRect().right > innerWidth + 1)
      .slice(0, 1).map(e => e.tagName + '.' + e.className + ': ' + e.textContent.trim().slice(0, 40))
      .concat([document.documentElement.scrollWidth + ' px']).join(' ')
  : ''"""


def missing() -> str:
    """Return why no browser can be used; empty if one can."""
    try:
        import playwright.sync_api  # noqa: F401 - only whether it is there
    except ImportError:
        return "no Playwright (pip install playwright)"
    return "" if _program() else f"no browser ({', '.join(BROWSERS)})"


def _program() -> str | None:
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@contextmanager
def opened() -> Iterator[Any]:
    """Open the browser and close it afterwards."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=_program(), args=arguments)
        yield browser
        browser.close()


@contextmanager
def page_in(browser: Any, home: str, width: int = 1280, scheme: str = "light", **options: Any) -> Iterator[Any]:
    """Open an empty page; yield it and the list of its console messages and requests outside ``home``."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme, **options)
    page = context.new_page()
    messages: list[str] = []
    page.on("console", lambda m: messages.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on(
        "request",
        lambda r: messages.append(f"requests {r.url[:80]}") if not r.url.startswith((home, "data:", "blob:")) else None,
    )
    yield page, messages
    context.close()


def faults_in_sight(page: Any, scope: str) -> list[str]:
    """Return elements within ``scope`` that scroll sideways and text with low contrast."""
    found = []
    if wide := page.evaluate(WIDE, scope):
        found.append(f"scrolls sideways, {wide}")
    ratio, text = page.evaluate(CONTRAST, scope)
    if ratio < LEAST_CONTRAST:
        found.append(f"contrast {ratio:.1f} of {text}")
    return found
