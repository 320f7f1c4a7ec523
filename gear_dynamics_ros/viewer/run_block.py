"""What the viewer draws of a run at a time: contiguous samples and what happened in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gear_dynamics_ros.channels import CHANNELS, IMPACTS
from gear_dynamics_ros.chunk import Chunk, Commands

Values = NDArray[np.float64]
NO_IMPACTS = np.empty((0, len(IMPACTS)))


class RunBlock(NamedTuple):
    """Contiguous samples of a run; SI units."""

    first_sample: int
    rows: Values  # (n, 28), n > 0, columns CHANNELS; best as ``joined`` makes them
    commands: Sequence[tuple[int, Commands]] = ()  # in force from a sample on, in order
    energies: Sequence[tuple[int, Values]] = ()  # ENERGIES (9,) after a sample, in order
    impacts: Values = NO_IMPACTS  # (k, 6), columns IMPACTS, contacts that ended


def joined(parts: Sequence[Values]) -> Values:
    """The first 28 columns of ``parts`` (n, 28 or more) in one array, each column contiguous in memory.

    Curves take one column of many samples: along a row of 28 that takes several times as long.
    """
    columns = np.empty((len(CHANNELS), sum(len(part) for part in parts)))
    begin = 0
    for part in parts:
        columns[:, begin : begin + len(part)] = part[:, : len(CHANNELS)].T
        begin += len(part)
    return columns.T


def blocks_of(chunks: Sequence[Chunk]) -> Iterator[RunBlock]:
    """The samples of ``chunks``, joined up to where a chunk is missing."""
    runs: list[list[Chunk]] = []
    for chunk in chunks:
        if not len(chunk):
            continue
        if runs and runs[-1][-1].first_sample + len(runs[-1][-1]) == chunk.first_sample:
            runs[-1].append(chunk)
        else:
            runs.append([chunk])
    for run in runs:
        last = run[-1]
        yield RunBlock(
            run[0].first_sample,
            joined([chunk.samples for chunk in run]),
            [(chunk.first_sample, chunk.commands) for chunk in run],
            [(last.first_sample + len(last) - 1, last.energies)],
            np.concatenate([chunk.impacts for chunk in run]),
        )
