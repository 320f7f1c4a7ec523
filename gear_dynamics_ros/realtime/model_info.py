"""Content of ``~/model_info``: describes the model, so that every topic can be read without this package."""

from __future__ import annotations

import json
from collections.abc import Iterable

from gear_dynamics_ros.channels import CHANNELS, ENERGIES, IMPACTS, PACE, Channel
from gear_dynamics_ros.messages.encoder import bearing_frame
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.simulation.provenance import current_provenance
from gear_dynamics_ros.topics import TOPICS, NodeNames


def describe_model(parameters: Parameters, epoch_ns: int, names: NodeNames) -> str:
    """JSON text about the model; ``epoch_ns`` is the ROS time of simulated time 0."""
    prefix, provenance = parameters.joint_prefix, current_provenance()
    named = {entry.name: entry for entry in (*CHANNELS, *ENERGIES)}
    solver = parameters.solver
    return json.dumps(
        {
            "package": "gear_dynamics_ros",
            "version": provenance.version,
            "kernel_hash": provenance.kernel_hash,
            "model_hash": provenance.model_hash,
            "epoch_ns": epoch_ns,
            "sample_interval_ns": solver.sample_interval_ns,
            "samples_per_chunk": solver.samples_per_chunk,
            "joints": [f"{prefix}{name}" for name in ("driving", "driven", "mesh")],
            "frames": [bearing_frame(prefix, gear) for gear in ("driving", "driven")],
            "waveform": _columns(named[name] for name in parameters.waveform_channels),
            "energy": _columns(ENERGIES),
            "impacts": _columns(IMPACTS),
            "pacing": _columns(PACE),
            "topics": {
                names.topic(key): {"declared": topic.name, "type": topic.type, "content": topic.content}
                for key, topic in TOPICS.items()
            },
            "parameters": parameters.to_flat(),
        }
    )


def _columns(entries: Iterable[Channel]) -> list[dict[str, str]]:
    return [entry._asdict() for entry in entries]
