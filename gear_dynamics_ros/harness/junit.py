"""Results as JUnit XML, which continuous integration reads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from gear_dynamics_ros.harness.results import Result

PLAYED = "played to its end"
_NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def write_report(path: Path, profile: str, results: Sequence[Result], failure: str) -> None:
    """Write a report to ``path``: a testcase an expectation, its time the window's length in simulated s.

    A failed expectation holds its reason. ``failure`` tells why the run broke off, empty if it did not: it is
    the error of a testcase of its own, and expectations whose window was not over count as skipped.
    Raises OSError.
    """
    suite = ElementTree.Element("testsuite", name="drive")
    for result in results:
        _add_case(suite, profile, result)
    if failure:
        case = ElementTree.SubElement(suite, "testcase", classname=_clean(profile), name=PLAYED, time="0")
        ElementTree.SubElement(case, "error", type="broken off", message=_clean(failure))
    for count, path_of_kind in (
        ("tests", "testcase"),
        ("failures", "*/failure"),
        ("errors", "*/error"),
        ("skipped", "*/skipped"),
    ):
        suite.set(count, str(len(suite.findall(path_of_kind))))
    suite.set("time", f"{sum(float(case.get('time', '0')) for case in suite):.9g}")
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    path.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _add_case(suite: ElementTree.Element, profile: str, result: Result) -> None:
    expectation = result.expectation
    case = ElementTree.SubElement(
        suite,
        "testcase",
        classname=_clean(profile),
        name=_clean(expectation.name),
        time=f"{expectation.end - expectation.start:.9g}",
    )
    if not result.complete:
        ElementTree.SubElement(case, "skipped", message=_clean(result.reason()))
    elif not result.passed:
        ElementTree.SubElement(case, "failure", type="expectation", message=_clean(result.reason()))


def _clean(text: str) -> str:
    """``text`` without the characters that XML has no way to hold."""
    return _NOT_XML.sub("\ufffd", text)
