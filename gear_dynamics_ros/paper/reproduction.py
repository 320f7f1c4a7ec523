"""Runs everything, and writes the page, its data and the figures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from gear_dynamics_ros.paper.cases import Effort, ParameterSet
from gear_dynamics_ros.paper.page import PaperReport, paper_json, paper_page
from gear_dynamics_ros.paper.parameter_sets import one_set, refined_set, set_by_section
from gear_dynamics_ros.paper.results import run_cases, run_count
from gear_dynamics_ros.paper.verdicts import compare
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.sweeps.point import Measurement, PointResult, measure
from gear_dynamics_ros.system.files import output_file, replace_files

PAGE: Final = "paper.md"
DATA: Final = "paper.json"


class Reproduction(NamedTuple):
    """What was run, and how much work it is."""

    parameters: Parameters
    effort: Effort
    workers: int  # threads

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return len(self._sets()) * run_count(self.effort)

    def _sets(self) -> tuple[ParameterSet, ParameterSet, ParameterSet]:
        return one_set(self.parameters), set_by_section(self.parameters), refined_set(self.parameters)

    def report(self, done: Callable[[], object]) -> PaperReport:
        """Run everything; ``done`` is called after each run, on any thread."""
        measure_once = RememberedPoints()
        comparisons = [
            compare(run_cases(parameter_set, self.effort, measure_once, self.workers, done))
            for parameter_set in self._sets()
        ]
        return PaperReport(self.effort, *comparisons)


class RememberedPoints:
    """``measure`` that runs no parameters twice: sets of parameters have many runs in common."""

    def __init__(self) -> None:
        self._known: dict[tuple[Parameters, Measurement], PointResult] = {}

    def __call__(self, parameters: Parameters, measurement: Measurement) -> PointResult:
        """As ``measure``."""
        key = (parameters, measurement)
        if key not in self._known:
            self._known[key] = measure(parameters, measurement)
        return self._known[key]


def write_report(report: PaperReport, folder: Path, progress: Callable[[int, int], object]) -> list[Path]:
    """Write page, data and figures into ``folder``, where they replace those of an earlier run.

    ``progress`` is called with the number of figures drawn and that of all. Returns the paths. Raises
    GearboxError if a file can't be written.
    """
    from gear_dynamics_ros.analysis.figures import write_small_png
    from gear_dynamics_ros.paper.figures import drawn, paper_figures

    figures = paper_figures(report.one_set.results, report.refined.results)
    files = [(f"{figure.name}.png", figure.caption) for figure in figures]
    names = [PAGE, DATA, *(name for name, _ in files)]
    with replace_files(folder, names) as draft:
        for name, text in ((PAGE, paper_page(report, files)), (DATA, paper_json(report))):
            with output_file(draft / name) as stream:
                stream.write(text.encode())
        for count, figure in enumerate(figures, start=1):
            with output_file(draft / f"{figure.name}.png") as stream:
                write_small_png(drawn(figure), stream)
            progress(count, len(figures))
    return [folder / name for name in names]
