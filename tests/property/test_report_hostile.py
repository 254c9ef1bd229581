"""Whatever a name contains, the report shows it as text: no markup, script, address, control or bidi characters."""

import html.parser
from xml.etree import ElementTree as ET

from hypothesis import example, given, settings
from hypothesis import strategies as st

from robustlab.report import junit_xml, render

ATTACKS = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onload='x",
    "javascript:alert(1)",
    "</pre></style><style>*{display:none}</style>",
    "{{ 7*7 }}{% for x in y %}",
    "\x1b[31mred\x1b[0m",
    "\u202eevil\u2066",
    "]]>&amp;<!--",
    "\x00\x07\x0b\ufffe\ud800",
    "../../etc/passwd",
]
names = st.one_of(st.sampled_from(ATTACKS), st.text(st.characters(), max_size=40))
numbers = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.booleans(), st.none(), names)

TAGS = """
html head meta title style body header main section nav footer p h1 h2 div small table thead tbody tr th td br span a ol
li ul dl dt dd details summary pre b code figure img figcaption
"""
ALLOWED_TAGS = set(TAGS.split())


class Tags(html.parser.HTMLParser):
    """Collects tags, attributes and the text outside of style."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


def result(name: str, value: object, met: bool) -> dict:
    """A result as result.json holds it, with ``name`` in every text."""
    step = dict.fromkeys(("name", "do", "title", "status", "summary", "text"), name) | {
        "trustworthy": met, "error": "" if met else name, "numbers": {name: value}, "notes": [name], "figures": [],
        "facts": [{"label": name, "value": name, "source": name}], "seconds": 0.0,
    }  # fmt: skip
    require = {"text": name, "that": name, "condition": name, "value": value, "met": met, "why_not": ""}
    recipe = dict.fromkeys(("name", "title", "file", "text"), name)
    recipe |= {"description": f"{name}\n\n{name}", "sha256": "0", "overrides": {name: name}}
    made = {"created": name, "inputs": {name: name}, "versions": {name: name}}
    return {
        "schema": "robustlab.result/1", "command": "run", "exit_code": 0, "requirements": [require], "steps": [step],
        "recipe": recipe, "seed": 0, "seconds": 1.0, "provenance": made, "files": [],
    }  # fmt: skip


@given(names, numbers, st.booleans())
@settings(max_examples=50)
@example("<script>alert(1)</script>", 1.0, True)
@example("\x00\x1b[31m\u202e\ufffe\ud800", "x", False)
def test_the_page_shows_every_name_as_text(tmp_path_factory, name, value, met):
    page = render(result(name, value, met), tmp_path_factory.getbasetemp())
    page.encode("utf-8")
    parsed = Tags()
    parsed.feed(page)
    assert {tag for tag, _ in parsed.tags} <= ALLOWED_TAGS
    for tag, attributes in parsed.tags:
        assert not [key for key in attributes if key.startswith("on")]
        assert (attributes.get("href") or "#step-").startswith("#step-")
        assert tag != "meta" or attributes.get("http-equiv") in (None, "Content-Security-Policy")
    assert parsed.tags.count(("style", {})) == 1
    assert all(ch.isprintable() or ch == "\n" for ch in parsed.text)
    assert not set(page) & set("\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u200e\u200f")


@given(names, numbers, st.booleans())
@settings(max_examples=50)
@example("]]>&<\x00\ufffe\ud800", 1.0, False)
def test_junit_is_well_formed_and_keeps_the_names(name, value, met):
    root = ET.fromstring(junit_xml(result(name, value, met)).encode())
    cases = root.findall(".//testcase")
    assert len(cases) == (1 if met else 2)
    assert len(root.findall(".//failure")) == (0 if met else 1)
    assert root.get("failures") == ("0" if met else "1")
    if name.isprintable() and name and not set(name) & set("\u200e\u200f"):
        assert cases[0].get("name") == name
