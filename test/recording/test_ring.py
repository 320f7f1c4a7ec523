"""The memory that the ring takes is known before it is taken."""

from __future__ import annotations

import gc
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.messages.encoder import Encoder
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.recording.ring import Ring, require_memory, ring_size
from gear_dynamics_ros.simulation.engine import Engine
from gear_dynamics_ros.simulation.run import Run
from gear_dynamics_ros.system.memory import available_memory
from support.processes import StartProcess


@pytest.mark.parametrize("values", [{}, {"solver.chunk": 1e-4}, {"waveform_channels": ["time"]}])
def test_a_ring_takes_the_memory_that_is_told(values: dict[str, Any]) -> None:
    parameters = Parameters.from_flat({"recording.ring_duration": 0.1, **values})
    engine = Engine(parameters)
    run = Run(engine, Encoder(parameters, 0))
    run.step()
    gc.collect()
    tracemalloc.start()
    try:
        run.attach(Ring(engine))
        most = 0
        while engine.sample < 25_000:
            run.step()
            most = max(most, tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert most <= ring_size(parameters) <= 1.5 * most


def test_a_ring_that_does_not_fit_is_refused_with_what_does() -> None:
    hour = Parameters.from_flat({"recording.ring_duration": 3600.0})
    assert 90e9 < ring_size(hour) < 100e9
    with pytest.raises(UsageError) as caught:
        require_memory(hour, 8_000_000_000)
    words = (
        "recording.ring_duration = 3600 s",
        "needs up to",
        "GB of memory",
        "8.00 GB",
        "reduce it to 150 s",
    )
    assert all(word in str(caught.value) for word in words), caught.value
    require_memory(Parameters.from_flat({"recording.ring_duration": 150.0}), 8_000_000_000)
    assert available_memory() > 0


def test_a_node_with_a_ring_of_terabytes_does_not_start(
    process: StartProcess, ros_domain: int, tmp_path: Path
) -> None:
    values = {
        "recording.path": tmp_path / "bag",
        "recording.mode": "ring",
        "recording.ring_duration": 3600.0,
        "solver.sample_interval": 1e-7,
        "solver.step": 1e-7,
    }
    settings = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    node = process("gearbox", "--ros-args", *settings)
    assert node.wait() == 2
    assert "recording.ring_duration = 3600 s needs up to" in node.stderr and "Traceback" not in node.stderr
    assert not (tmp_path / "bag").exists()
