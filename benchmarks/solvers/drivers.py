"""General solvers on the model, every event located: SciPy's DOP853 and LSODA, and SUNDIALS' CVODE.

Each is used as well as its interface allows: right-hand side and switching surfaces are compiled, and the
integration starts afresh from every event. LSODA comes twice: through ``solve_ivp``, and stepped by hand with
a compiled search of its interpolant, which saves most of what Python costs around it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from scipy.integrate import LSODA, solve_ivp
from sksundae.cvode import CVODE

from solvers.model import EVENT_COUNT, STATE_SIZE, Floats, Model, compiled

# (tolerance, times) -> DTE in m at each of the times, which begin with 0.
Driver: TypeAlias = Callable[[float, Floats], Floats]

# Tolerances are absolute, a fraction of the vibration: the spin is a thousand times as large, and smooth.
RELATIVE = 3e-14
LONGEST_STEP = 1e-5  # s; in free flight a solver would leap over a whole contact
AN_INSTANT = 1e-12  # s, to tell a surface's direction
LOOKS = 4  # within a step, for a surface met and left again
SEARCH_LIMIT = 60
MOST_EVENTS = 1000  # more would be a run that no longer moves
CVODE_STEPS = 1_000_000
CVODE_ROOT = 2
SOLVE_IVP_EVENT = 1


def drivers(model: Model) -> dict[str, Driver]:
    """The solvers by name."""
    return {
        "SciPy solve_ivp, DOP853": solve_ivp_driver(model, "DOP853"),
        "SciPy solve_ivp, LSODA": solve_ivp_driver(model, "LSODA"),
        "SciPy LSODA, stepped by hand": lsoda_driver(model),
        "CVODE, BDF": cvode_driver(model, "BDF"),
        "CVODE, Adams": cvode_driver(model, "Adams"),
        "CVODE, Adams, no Jacobian": cvode_driver(model, "Adams", jacfn=zero_jacobian),
    }


def scipy_rates(model: Model) -> Any:
    """Compiled (t, y, mode) -> dy/dt."""
    derivative = model.derivative

    @compiled
    def rates(t: float, y: Floats, mode: Floats) -> Floats:
        rate = np.empty(STATE_SIZE)
        derivative(t, y, rate, mode)
        return rate

    return rates


def solve_ivp_driver(model: Model, method: str) -> Driver:
    """Integration by SciPy's solve_ivp and its terminal events."""
    rates = scipy_rates(model)

    def run(tolerance: float, times: Floats) -> Floats:
        t, y, mode = 0.0, model.state, model.mode.copy()
        events = solve_ivp_events(model, mode)
        found = [model.dte(t, y)]
        for _ in range(MOST_EVENTS):
            result = solve_ivp(
                lambda t, y: rates(t, y, mode),
                (t, times[-1]),
                y,
                method=method,
                t_eval=times[len(found) :],
                events=events,
                max_step=LONGEST_STEP,
                rtol=RELATIVE,
                atol=tolerance * model.scale,
            )
            if not result.success:
                raise RuntimeError(f"{method} failed after t = {t} s: {result.message}")
            found += [model.dte(*sample) for sample in zip(result.t, np.transpose(result.y), strict=True)]
            if result.status == SOLVE_IVP_EVENT:
                event = next(k for k, when in enumerate(result.t_events) if len(when))
                t, y = result.t_events[event][0], result.y_events[event][0]
                settle(model, t, y, event, mode)
            if len(found) == len(times):
                return np.array(found)
        raise RuntimeError(f"{method}: {MOST_EVENTS} events by t = {t} s")

    return run


def solve_ivp_events(model: Model, mode: Floats) -> list[Any]:
    """One terminal event for each switching surface, met where its value turns negative."""
    value = np.empty(EVENT_COUNT)

    def surface(index: int) -> Any:
        def event(t: float, y: Floats) -> float:
            model.values(t, y, value, mode)
            return float(value[index])

        event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        return event

    return [surface(index) for index in range(EVENT_COUNT)]


def settle(model: Model, t: float, y: Floats, event: int | None, mode: Floats) -> None:
    """Apply ``event`` and all that fall together with it.

    A surface that is passed before the next start, and left behind, would not be seen to be passed.
    """
    applied, rate = set(), np.empty(STATE_SIZE)
    value, ahead = np.empty(EVENT_COUNT), np.empty(EVENT_COUNT)
    while event is not None:
        model.apply(t, y, event, mode)
        applied.add(event)
        model.derivative(t, y, rate, mode)
        model.values(t, y, value, mode)
        model.values(t + AN_INSTANT, y + AN_INSTANT * rate, ahead, mode)
        passed = np.flatnonzero((value <= 0.0) & (ahead < value)).tolist()
        event = min(set(passed) - applied, default=None)


def cvode_driver(model: Model, method: str, **options: Any) -> Driver:
    """Integration by SUNDIALS' CVODE with its own root finding."""
    derivative, values = model.derivative, model.values

    def run(tolerance: float, times: Floats) -> Floats:
        t, y, mode = 0.0, model.state, model.mode.copy()

        def rates(t: float, y: Floats, rate: Floats) -> None:
            derivative(t, y, rate, mode)

        def surfaces(t: float, y: Floats, value: Floats) -> None:
            values(t, y, value, mode)

        surfaces.terminal = [True] * EVENT_COUNT  # type: ignore[attr-defined]
        surfaces.direction = [-1] * EVENT_COUNT  # type: ignore[attr-defined]
        solver = CVODE(
            rates,
            method=method,
            rtol=RELATIVE,
            atol=tolerance * model.scale,
            max_step=LONGEST_STEP,
            max_num_steps=CVODE_STEPS,
            eventsfn=surfaces,
            num_events=EVENT_COUNT,
            **options,
        )
        found = [model.dte(t, y)]
        for _ in range(MOST_EVENTS):
            ahead = times[len(found) :]
            # Given two times alone, it would answer at steps of its own: the second of three is not used.
            result = solver.solve([t, 0.5 * (t + ahead[0]), *ahead], y)
            if not result.success:
                raise RuntimeError(f"CVODE failed at t = {result.t[-1]} s: {result.message}")
            met = result.status == CVODE_ROOT
            found += [model.dte(result.t[k], result.y[k]) for k in range(2, len(result.t) - met)]
            if met:
                t, y = result.t[-1], result.y[-1]
                settle(model, t, y, int(np.flatnonzero(result.i_events[-1])[0]), mode)
            if len(found) == len(times):
                return np.array(found)
        raise RuntimeError(f"CVODE: {MOST_EVENTS} events by t = {t} s")

    return run


def zero_jacobian(t: float, y: Floats, rate: Floats, jacobian: Floats) -> None:
    """Makes CVODE's Newton iteration the plain fixed-point one, which suits a problem that is not stiff."""


def lsoda_driver(model: Model) -> Driver:
    """SciPy's LSODA step by step, its Nordsieck array searched and sampled by compiled code."""
    rates, crossed = scipy_rates(model), compiled_crossed(model)
    locate, sample = compiled_locate(model), compiled_sample(model)

    def run(tolerance: float, times: Floats) -> Floats:
        t, y, mode = 0.0, model.state, model.mode.copy()
        found, known = np.empty(len(times)), 1
        found[0] = model.dte(t, y)
        for _ in range(MOST_EVENTS):
            solver = LSODA(
                lambda t, y: rates(t, y, mode),
                t,
                y,
                times[-1],
                max_step=LONGEST_STEP,
                rtol=RELATIVE,
                atol=tolerance * model.scale,
            )
            event = False
            while not event and solver.status == "running":
                solver.step()
                event = crossed(solver.t, solver.y, mode)
                if event or times[known] <= solver.t:
                    dense = solver.dense_output()
                    curve = dense.t, dense.h, np.ascontiguousarray(dense.yh.T)
                    until = solver.t
                    if event:
                        until, y = locate(solver.t_old, solver.t, *curve, mode)
                    known = sample(until, known, times, *curve, found)
            if solver.status == "failed":
                raise RuntimeError(f"LSODA failed at t = {solver.t} s")
            if known == len(times):
                return found
            t = until
        raise RuntimeError(f"LSODA: {MOST_EVENTS} events by t = {t} s")

    return run


def compiled_crossed(model: Model) -> Any:
    """Compiled (t, y, mode) -> whether a switching surface has been passed."""
    values = model.values

    @compiled
    def crossed(t: float, y: Floats, mode: Floats) -> bool:
        value = np.empty(EVENT_COUNT)
        values(t, y, value, mode)
        return bool(value.min() < 0.0)

    return crossed


@compiled
def state_at(t: float, origin: float, step: float, nordsieck: Floats, y: Floats) -> None:
    """Fill ``y`` from the polynomial sum_k nordsieck_k ((t - origin) / step)^k."""
    x = (t - origin) / step
    y[:] = 0.0
    for k in range(nordsieck.shape[0] - 1, -1, -1):
        for i in range(STATE_SIZE):
            y[i] = y[i] * x + nordsieck[k, i]


def compiled_locate(model: Model) -> Any:
    """Compiled search for the first event of a step.

    Returns its time and the state there, and changes the mode.
    """
    values, apply = model.values, model.apply

    @compiled
    def value_at(t: float, event: int, origin: float, step: float, nordsieck: Floats, mode: Floats) -> float:
        y, value = np.empty(STATE_SIZE), np.empty(EVENT_COUNT)
        state_at(t, origin, step, nordsieck, y)
        values(t, y, value, mode)
        found: float = value[event]
        return found

    @compiled
    def root(
        event: int, low: float, high: float, origin: float, step: float, nordsieck: Floats, mode: Floats
    ) -> float:
        """First time found past the surface between ``low`` and ``high``: regula falsi after Illinois."""
        at_low = value_at(low, event, origin, step, nordsieck, mode)
        at_high = value_at(high, event, origin, step, nordsieck, mode)
        if at_low <= 0.0:
            return low
        side = 0
        for _ in range(SEARCH_LIMIT):
            t = (low * at_high - high * at_low) / (at_high - at_low)
            if not low < t < high:
                break
            value = value_at(t, event, origin, step, nordsieck, mode)
            if value < 0.0:
                high, at_high = t, value
                at_low *= 0.5 if side < 0 else 1.0
                side = -1
            else:
                low, at_low = t, value
                at_high *= 0.5 if side > 0 else 1.0
                side = 1
        return high

    @compiled
    def locate(
        t0: float, t1: float, origin: float, step: float, nordsieck: Floats, mode: Floats
    ) -> tuple[float, Floats]:
        y, value = np.empty(STATE_SIZE), np.empty(EVENT_COUNT)
        low, first, when = t0, -1, t1
        for look in range(1, LOOKS + 1):
            high = t0 + (t1 - t0) * look / LOOKS
            state_at(high, origin, step, nordsieck, y)
            values(high, y, value, mode)
            for event in range(EVENT_COUNT):
                if value[event] < 0.0:
                    t = root(event, low, high, origin, step, nordsieck, mode)
                    if first < 0 or t < when:
                        first, when = event, t
            if first >= 0:
                break
            low = high
        state_at(when, origin, step, nordsieck, y)
        if first >= 0:
            apply(when, y, first, mode)
        return when, y

    return locate


def compiled_sample(model: Model) -> Any:
    """Compiled filling of ``found`` at the times up to ``until``, from index ``known`` on; the next index."""
    dte = model.dte

    @compiled
    def sample(
        until: float,
        known: int,
        times: Floats,
        origin: float,
        step: float,
        nordsieck: Floats,
        found: Floats,
    ) -> int:
        y = np.empty(STATE_SIZE)
        while known < times.shape[0] and times[known] <= until:
            state_at(times[known], origin, step, nordsieck, y)
            found[known] = dte(times[known], y)
            known += 1
        return known

    return sample
