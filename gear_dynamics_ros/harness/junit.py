"""Results as JUnit XML, which continuous integration reads."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.harness.expectations import Expectation
from gear_dynamics_ros.harness.results import Result, unreached
from gear_dynamics_ros.system.files import replace_file

PLAYED = "played to its end"
_NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class JunitReport:
    """The report file of one profile, there from the start of the run on."""

    def __init__(self, path: Path, profile: str) -> None:
        """``profile`` is the name of the profile, as test case class."""
        self._path = path
        self._profile = profile

    def write_unfinished(self, expectations: Sequence[Expectation]) -> None:
        """Write the report of a run that did not end, which stays if this process is killed.

        Raises UsageError if the file can't be written.
        """
        try:
            self.write(unreached(expectations), "drive did not end by itself")
        except OSError as error:
            raise UsageError(
                f"--junit {self._path}: {error.strerror}; name a file in a folder that can be written to"
            ) from error

    def write(self, results: Sequence[Result], failure: str) -> None:
        """Write ``results``, and as ``failure`` why the run broke off (empty if it did not).

        Raises OSError if the file can't be written; the earlier report stays then.
        """
        with replace_file(self._path) as stream:
            stream.write(junit_xml(self._profile, results, failure))


def junit_xml(profile: str, results: Sequence[Result], failure: str) -> bytes:
    """JUnit XML with a test case for each expectation, its time the window's length in simulated s.

    A failed expectation holds its reason, and one that can't be judged an error. ``failure`` says why the run
    broke off, empty if it did not: it is the error of a test case of its own, and expectations whose
    window was not over count as skipped.
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
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text + b"\n"


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
    elif result.unjudged:
        ElementTree.SubElement(case, "error", type="too slow", message=_clean(result.reason()))
    elif not result.passed:
        ElementTree.SubElement(case, "failure", type="expectation", message=_clean(result.reason()))


def _clean(text: str) -> str:
    """``text`` with the characters that XML can't hold replaced."""
    return _NOT_XML.sub("\ufffd", text)
