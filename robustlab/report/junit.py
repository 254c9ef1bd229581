"""The requirements of a run as a JUnit file, so that a CI system shows each of them as a test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

from robustlab.errors import plain_text

__all__ = ["junit_xml"]


def junit_xml(result: Mapping[str, Any]) -> str:
    """JUnit XML: one test case per requirement, one more per step that ended without a trustworthy number.

    Texts are escaped for XML; characters that XML cannot carry are shown as escapes.
    """
    requirements = result["requirements"]
    doubtful = [s for s in result["steps"] if not s["trustworthy"]]
    failures = sum(not q["met"] for q in requirements)
    name = plain_text(str(result["recipe"]["name"]))
    counts = {"tests": len(requirements) + len(doubtful), "failures": failures, "errors": len(doubtful)}
    attributes = {"name": name, **{key: str(n) for key, n in counts.items()}, "time": f"{float(result['seconds']):.3f}"}
    suites = ET.Element("testsuites", attributes)
    suite = ET.SubElement(suites, "testsuite", attributes)
    for q in requirements:
        case = ET.SubElement(
            suite, "testcase", {"classname": f"{name}.requirements", "name": plain_text(str(q["text"] or q["that"]))}
        )
        if not q["met"]:
            reason = q["why_not"] or f"{q['that']} is {q['value']}, required: {q['condition']}"
            ET.SubElement(case, "failure", {"message": plain_text(str(reason))})
    for s in doubtful:
        case = ET.SubElement(suite, "testcase", {"classname": f"{name}.steps", "name": plain_text(str(s["name"]))})
        reason = s["error"] or f"status {s['status']}"
        ET.SubElement(case, "error", {"message": plain_text(str(reason))})
    ET.indent(suites)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(suites, encoding="unicode") + "\n"
