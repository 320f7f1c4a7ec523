"""Speed of the engine: time per step and times real time, without and with recording; error beside it.

Every figure is the median of repeated runs; compilation is excluded. Prints a table; --output writes it too.
"""

from __future__ import annotations

import argparse
import csv
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from gear_dynamics_ros.engine import Engine
from gear_dynamics_ros.messages import Encoder
from gear_dynamics_ros.parameters import Parameters, load
from gear_dynamics_ros.recording.writer import Recorder

SOURCE = Path(__file__).resolve().parent.parent
CASES = SOURCE / "test" / "cases"
WARM_CHUNKS = 100
CHUNKS = 250
REPEATS = 5
REFEREE_SAMPLES = 101


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="also write the table to this file")
    output: Path | None = parser.parse_args().output
    lines = [
        "| parameters | model | ns per step | times real time | with recording |",
        "|---|---|---|---|---|",
    ]
    for name in ("paper", "gearbox"):
        for model in ("traditional", "compared", "improved"):
            parameters = replace(load(SOURCE / "config" / f"{name}.yaml"), model=model)
            lines.append(row(name, parameters))
            print(lines[-1], flush=True)
    lines += ["", "| referee case | step | error of DTE over the first millisecond |", "|---|---|---|"]
    for case in ("traditional_6000", "refined_9000"):
        for divisor in (1, 8):
            lines.append(f"| {case} | 1/{divisor} us | {referee_error(case, divisor) * 1e9:.2g} nm |")
    text = "\n".join(lines)
    print(f"\n{text}")
    if output is not None:
        output.write_text(text + "\n", encoding="utf-8")


def row(name: str, parameters: Parameters) -> str:
    """One line of the table."""
    plain, recorded = [], []
    for _ in range(REPEATS):
        plain.append(seconds(parameters))
        recorded.append(seconds_recording(parameters))
    simulated = CHUNKS * parameters.solver.chunk
    alone, with_files = statistics.median(plain), statistics.median(recorded)
    return (
        f"| {name}.yaml | {parameters.model} | {alone / simulated * parameters.solver.step * 1e9:.0f} | "
        f"{simulated / alone:.2f} | {simulated / with_files:.2f} |"
    )


def warm(parameters: Parameters) -> Engine:
    """An engine past its transient, as far as WARM_CHUNKS reach."""
    engine = Engine(parameters)
    for _ in range(WARM_CHUNKS):
        engine.advance()
    return engine


def seconds(parameters: Parameters) -> float:
    """Wall time of CHUNKS chunks."""
    engine = warm(parameters)
    began = time.perf_counter()
    for _ in range(CHUNKS):
        engine.advance()
    return time.perf_counter() - began


def seconds_recording(parameters: Parameters) -> float:
    """The same with every message made, written and the file finished."""
    engine = warm(parameters)
    with tempfile.TemporaryDirectory() as folder:
        recorder = Recorder(Path(folder) / "bag", parameters, engine.checkpoint(), 0)
        encoder = Encoder(parameters, 0)
        began = time.perf_counter()
        for _ in range(CHUNKS):
            recorder.write(encoder.chunk(engine.advance()))
        recorder.close()
        return time.perf_counter() - began


def referee_error(case: str, divisor: int) -> float:
    """Largest deviation of DTE, m, from an independent solver's run at a fraction of the usual step."""
    parameters = load(CASES / f"{case}.yaml", [f"solver.step={1e-6 / divisor!r}"])
    with (CASES / f"{case}.csv").open(encoding="utf-8") as file:
        reference = np.array([float(entry["dte"]) for entry in csv.DictReader(file)])[:REFEREE_SAMPLES]
    dte = Engine(parameters).advance(REFEREE_SAMPLES)["dte"]
    return float(np.abs(dte - reference).max())


if __name__ == "__main__":
    main()
