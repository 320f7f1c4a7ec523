"""The folder of a sweep: its plan, a file for each point that is done, and the dataset made of them."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from gear_dynamics_ros.errors import GearboxError, UsageError
from gear_dynamics_ros.simulation.provenance import current_provenance
from gear_dynamics_ros.sweeps.axis import Axis
from gear_dynamics_ros.sweeps.branch import PointOutcome
from gear_dynamics_ros.sweeps.plan import Index, SweepPlan
from gear_dynamics_ros.sweeps.point import ARRAYS, REGIMES, SCALARS, PointResult, ended, spectrum_orders
from gear_dynamics_ros.system.files import output_file, replace_file, replace_text

PLAN: Final = "plan.json"
POINTS: Final = "points"
DATASET: Final = "sweep.nc"
NOT_COMPUTED: Final = "not computed"


class SweepFolder:
    """The folder of one sweep on the disk. Nothing in it is lost when the sweep is interrupted."""

    def __init__(self, path: Path, plan: SweepPlan) -> None:
        self.path = path
        self.plan = plan

    @classmethod
    def begin(cls, path: Path, plan: SweepPlan) -> SweepFolder:
        """A new folder at ``path``. Raises UsageError if there is something already, or it can't be made."""
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise UsageError(
                f"'{path}' exists already: give --resume to finish the sweep in it, or choose another name"
            )
        try:
            (path / POINTS).mkdir(parents=True)
            replace_text(path / PLAN, _identity(plan))
        except OSError as error:
            raise UsageError(
                f"can't make '{path}': {error.strerror or error}: choose a writable place"
            ) from error
        return cls(path, plan)

    @classmethod
    def resume(cls, path: Path, plan: SweepPlan) -> SweepFolder:
        """The folder of an interrupted sweep. Raises UsageError if it holds none, or one of another plan."""
        try:
            stored = json.loads((path / PLAN).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise UsageError(f"'{path}' holds no sweep to resume: {PLAN} can't be read ({error})") from error
        wanted = json.loads(_identity(plan))
        if not isinstance(stored, dict):
            raise UsageError(f"'{path}' holds no sweep to resume: {PLAN} is not that of a sweep")
        different = _differences(stored, wanted)
        if different:
            raise UsageError(
                f"'{path}' holds another sweep, which differs in {', '.join(different[:5])}: "
                "choose another folder, or give the same options"
            )
        (path / POINTS).mkdir(exist_ok=True)
        return cls(path, plan)

    def put(self, outcome: PointOutcome) -> None:
        """Keep the outcome of one point. Raises GearboxError if it can't be written. For any thread."""
        buffer = io.BytesIO()
        np.savez(
            buffer,
            scalars=np.array([outcome.result.scalars[name] for name in SCALARS]),
            status=np.array(outcome.result.status),
            state=np.frombuffer(outcome.state, np.uint8),
            **outcome.result.arrays,  # type: ignore[arg-type]
        )
        with output_file(self._file(outcome.point)) as stream:
            stream.write(buffer.getvalue())

    def has(self, point: Index) -> bool:
        """Whether ``point`` is done."""
        return self._file(point).exists()

    def get(self, point: Index) -> PointOutcome:
        """The outcome of a point that is done. Raises GearboxError if its file is damaged."""
        try:
            with np.load(self._file(point), allow_pickle=False) as stored:
                return PointOutcome(
                    point,
                    PointResult(
                        dict(zip(SCALARS, map(float, stored["scalars"]), strict=True)),
                        {name: stored[name] for name in ARRAYS},
                        str(stored["status"]),
                    ),
                    stored["state"].tobytes(),
                )
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise GearboxError(
                f"'{self._file(point)}' is damaged ({error}): remove it and give --resume to compute it anew"
            ) from error

    def _file(self, point: Index) -> Path:
        return self.path / POINTS / f"{'-'.join(map(str, point))}.npz"

    def dataset(self) -> xr.Dataset:
        """All points, see ``make_dataset``; those that are not done are NaN with the status NOT_COMPUTED."""
        return make_dataset(self.plan, (self.get(point) for point in self.plan.points() if self.has(point)))

    def write_dataset(self, dataset: xr.Dataset) -> Path:
        """Write ``dataset`` as NetCDF4; returns the file. Raises GearboxError if that fails."""
        path = self.path / DATASET
        compressed = {name: {"zlib": True} for name in dataset.data_vars if name != "status"}
        draft = self.path / f".{DATASET}"
        try:
            dataset.to_netcdf(draft, engine="netcdf4", encoding=compressed)
            with replace_file(path) as stream:
                stream.write(draft.read_bytes())
        except OSError as error:
            raise GearboxError(f"can't write '{path}': {error.strerror or error}: free space") from error
        finally:
            draft.unlink(missing_ok=True)
        return path


def make_dataset(plan: SweepPlan, outcomes: Iterable[PointOutcome]) -> xr.Dataset:
    """Labelled dataset of ``outcomes``: a variable for each result, dimensions named after what is swept.

    Also the dimensions ``model``, ``direction`` (if there are two ways), ``section`` and ``order``. All
    numbers are SI units, which each variable names. The attributes hold the plan, all parameters and the
    provenance.
    """
    nothing = ended(plan.measurement, NOT_COMPUTED)
    scalars = {name: np.full(plan.shape, np.nan) for name in SCALARS}
    arrays = {name: np.full((*plan.shape, len(nothing.arrays[name])), np.nan) for name in ARRAYS}
    status: NDArray[Any] = np.full(plan.shape, NOT_COMPUTED, dtype=object)
    for point, result, _ in outcomes:
        for name, value in result.scalars.items():
            scalars[name][point] = value
        for name, values in result.arrays.items():
            arrays[name][point] = values
        status[point] = result.status
    dims = ("model", "direction", *(axis.name for axis in plan.axes))
    last = {"dte_spectrum": "order"}
    variables: dict[str, Any] = {
        name: (dims, values, {"units": SCALARS[name]}) for name, values in scalars.items()
    }
    for name, values in arrays.items():
        variables[name] = ((*dims, last.get(name, "section")), values, {"units": ARRAYS[name]})
    variables["regime"][2].update(flag_values=np.arange(3.0), flag_meanings=" ".join(REGIMES))
    variables["status"] = (dims, status, {"long_name": "done, or why there is no result"})
    dataset = xr.Dataset(variables, _coordinates(plan), _attributes(plan))
    return dataset if len(plan.ways) > 1 else dataset.squeeze("direction", drop=True)


def _coordinates(plan: SweepPlan) -> dict[str, Any]:
    order = {"units": "1", "long_name": "frequency over mesh frequency"}
    return {
        "model": list(plan.models),
        "direction": list(plan.ways),
        **{axis.name: (axis.name, list(axis.values), _axis_attributes(axis)) for axis in plan.axes},
        "section": ("section", np.arange(plan.measurement.keep), {"long_name": "kept mesh period"}),
        "order": ("order", spectrum_orders(plan.measurement.keep), order),
    }


def _axis_attributes(axis: Axis) -> dict[str, str]:
    sets = ", ".join(map(str, axis.targets))
    return {"units": axis.unit or "1", "long_name": axis.meaning, **({"sets": sets} if sets else {})}


def _attributes(plan: SweepPlan) -> dict[str, Any]:
    return {
        "title": "sweep of a virtual gearbox",
        "direction": plan.direction,
        "transient_periods": plan.measurement.transient,
        "kept_periods": plan.measurement.keep,
        "steps_per_period": plan.measurement.steps_per_period,
        "parameters": json.dumps(plan.parameters.to_flat()),
        **{f"provenance_{name}": text for name, text in current_provenance()._asdict().items()},
    }


def _identity(plan: SweepPlan) -> str:
    """The plan, and the program whose numbers a folder may hold together."""
    provenance = current_provenance()
    return json.dumps({**json.loads(plan.to_json()), "model_hash": provenance.model_hash}, indent=1)


def _differences(stored: dict[str, Any], wanted: dict[str, Any], prefix: str = "") -> list[str]:
    names = []
    for name in {**stored, **wanted}:
        before, now = stored.get(name), wanted.get(name)
        if isinstance(before, dict) and isinstance(now, dict):
            names += _differences(before, now, f"{prefix}{name} ")
        elif before != now:
            names.append(prefix + name)
    return names
