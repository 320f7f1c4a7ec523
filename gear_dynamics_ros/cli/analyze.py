"""``analyze BAG --output DIR``: figures and numbers of a recording."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from gear_dynamics_ros import recording
from gear_dynamics_ros.analysis import ledger, summary
from gear_dynamics_ros.analysis.spectra import SHORTEST
from gear_dynamics_ros.analysis.statistics import Envelope, Statistics, quantities
from gear_dynamics_ros.analysis.summary import Span
from gear_dynamics_ros.channels import GEARS, contact_channels
from gear_dynamics_ros.chunk import Samples
from gear_dynamics_ros.cli.common import Progress, guarded
from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.events import RESET, RESTORE
from gear_dynamics_ros.recording import OperatorEvent, Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WINDOW_SAMPLES: Final = 1_000_000
SUMMARY_FILE: Final = "summary.json"
IMPACTS_FILE: Final = "impacts.csv"


class Pass(NamedTuple):
    """What one pass through the whole recording gave."""

    statistics: Statistics
    envelope: Envelope


def main(argv: list[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="analyze",
        description="Figures (PNG), a summary (JSON) and the bearing impacts (CSV) of a recording. "
        "The overview shows the whole run, the others a window: "
        f"by default the last {summary.WINDOW:g} s without a change of commands.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 folder or .mcap file")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--from", dest="start", type=float, metavar="S", help="window's start, simulated s")
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="window's end, simulated s")
    return guarded(analyze, parser, argv)


def analyze(arguments: argparse.Namespace) -> int:
    """Read, compute, draw, write."""
    if arguments.output.exists() and not arguments.output.is_dir():
        raise UsageError(f"--output {arguments.output} is a file: name a folder")
    bag = recording.open(arguments.bag)
    if bag.end_sample == bag.first_sample:
        raise GearboxError(f"{arguments.bag} holds no samples: nothing to analyse")
    changes = change_times(bag)
    window = choose_window(bag, changes, arguments.start, arguments.end)
    samples = bag.window(*window)
    whole = survey(bag)
    arguments.output.mkdir(parents=True, exist_ok=True)
    found = describe(bag, whole, samples)
    written = [arguments.output / SUMMARY_FILE]
    found["energy"], found["impacts"] = energy(bag), None
    if found["energy"] is not None:  # every chunk brings energies, but only some of them impacts
        written.append(arguments.output / IMPACTS_FILE)
        found["impacts"] = list_impacts(bag, written[-1])
    written[0].write_text(json.dumps(found, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    figures = drawings(bag, whole, samples, changes)
    with Progress("drawing", len(figures)) as progress:
        for drawn, (name, draw) in enumerate(figures.items(), start=1):
            written.append(arguments.output / f"{name}.png")
            draw().savefig(written[-1])
            progress(drawn)
    for path in written:
        print(path)
    return 0


def interval(bag: Recording) -> float:
    """Sample interval in s."""
    return bag.parameters.solver.sample_interval


def whole_span(bag: Recording) -> Span:
    """Simulated time that the recording covers."""
    return Span(bag.first_sample * interval(bag), bag.end_sample * interval(bag))


def change_times(bag: Recording) -> list[float]:
    """When commands changed or something happened, s; not the first commands, which only set the start."""
    samples = [sample for sample, _ in bag.commands] + [event.sample for event in bag.events]
    inside = [sample for sample in samples if bag.first_sample < sample < bag.end_sample]
    return summary.changes(inside, interval(bag))


def choose_window(bag: Recording, changes: Sequence[float], start: float | None, end: float | None) -> Span:
    """The window asked for, or the steady one; raises UsageError if it is empty, outside or too long."""
    whole = whole_span(bag)
    if start is None and end is None:
        return summary.steady_window(whole, changes)
    window = Span(whole.start if start is None else start, whole.end if end is None else end)
    asked = f"--from {window.start:g} --to {window.end:g} s"
    if not (math.isfinite(window.start) and math.isfinite(window.end)):
        raise UsageError(f"{asked}: give finite times")
    # Half a sample of slack: the ends as printed in a summary must be accepted.
    slack = 0.5 * interval(bag)
    if window.start < whole.start - slack or window.end > whole.end + slack:
        raise UsageError(f"{asked} leaves the recording: stay within {whole.start:g} and {whole.end:g} s")
    count = round((window.end - window.start) / interval(bag))
    if count < SHORTEST:
        raise UsageError(f"{asked} holds {max(count, 0)} samples: take at least {SHORTEST}")
    if count > WINDOW_SAMPLES:
        raise UsageError(f"{asked} is longer than {WINDOW_SAMPLES * interval(bag):g} s: take less")
    return window


def survey(bag: Recording) -> Pass:
    """One pass through everything, in pieces."""
    found = Pass(Statistics(), Envelope())
    with Progress("reading", bag.end_sample - bag.first_sample) as progress:
        for samples in bag.blocks():
            columns = quantities(samples)
            found.statistics.add(samples, columns)
            found.envelope.add(samples, columns)
            progress(found.statistics.samples)
    return found


def describe(bag: Recording, whole: Pass, samples: Samples) -> dict[str, Any]:
    """The summary."""
    span = whole_span(bag)
    return {
        "recording": str(bag.path),
        "complete": bag.complete,
        "version": bag.version,
        "kernel_hash": bag.kernel_hash,
        "model": bag.parameters.model,
        "duration": span.end - span.start,
        "samples": bag.end_sample - bag.first_sample,
        "sample_interval": interval(bag),
        "commands": len(bag.commands),
        "events": [described(event) for event in bag.events],
        "run": summary.statistics_block(whole.statistics, span, bag.parameters),
        "window": summary.window_block(samples, bag.parameters),
    }


def described(event: OperatorEvent) -> dict[str, Any]:
    """An event for the summary; the state that a restore brought stays in the recording."""
    entries = event._asdict()
    del entries["checkpoint"]
    entries["parameters"] = dict(event.parameters)
    return entries


def energy(bag: Recording) -> dict[str, Any] | None:
    """The energy balance over the whole recording, None where it lacks the topic."""
    balance = ledger.Ledger([event.sample for event in bag.events if event.kind in (RESET, RESTORE)])
    for time_ns, rows in bag.rows("energy"):
        balance.add(bag.sample_of(time_ns) + 1, rows[0])
    return balance.block(interval(bag), bag.parameters)


def list_impacts(bag: Recording, path: Path) -> dict[str, Any]:
    """Write the list of impacts to ``path``; totals by bearing."""
    totals = ledger.Impacts(bag.parameters.bearings.minimum_impact_speed)
    with path.open("w", encoding="utf-8") as file:
        file.write(ledger.CSV_HEADER + "\n")
        for _, rows in bag.rows("impacts"):
            totals.add(rows)
            file.writelines(ledger.csv_lines(rows))
    return {"list": path.name, **totals.block()}


def drawings(
    bag: Recording, whole: Pass, samples: Samples, changes: Sequence[float]
) -> dict[str, Callable[[], Figure]]:
    """Figures by file name, those for which the channels were recorded."""
    from gear_dynamics_ros.analysis import figures

    shown = (float(samples.time[0]), float(samples.time[-1]))
    motion = [f"{gear}_{axis}" for gear in GEARS for axis in "xy"]
    loops = [name for gear in GEARS for name in (f"{gear}_penetration", *contact_channels(gear))]
    possible: dict[str, tuple[bool, Callable[[], Figure]]] = {
        "overview": (
            figures.has_overview(whole.envelope),
            lambda: figures.overview(whole.envelope, changes, shown),
        ),
        "time_series": (samples.has("dte"), lambda: figures.time_series(samples, bag.parameters)),
        "spectrum": (samples.has("dte") and len(samples) >= SHORTEST, lambda: figures.spectrum(samples)),
        "phase_portrait": (samples.has("dte", "dte_rate"), lambda: figures.phase_portrait(samples)),
        "orbits": (samples.has(*motion), lambda: figures.orbits(samples, bag.parameters)),
        "bearing_force": (samples.has(*loops), lambda: figures.bearing_force(samples)),
    }
    return {name: draw for name, (there, draw) in possible.items() if there}
