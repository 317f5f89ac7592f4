"""Fit a phantom heart's distances by gradient descent (eq. 3), conjugate gradients and exactly.

Each network is trained on the signed distances of a phantom heart at end-diastole, sampled on a regular
grid. Cost is Σ (d − d̂)² (eq. 2); how far it lies above its minimum is followed over iterations and over
time. The unit is the heart; trials run one after the other, because they measure time.

    dvf-ig study training --degrees 2,3 -o study
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from data_synth.heart.anatomy import phantom_anatomy
from dvf_ig.core import FloatArray, IntArray, InvalidInputError, Mesh, read_only_arrays
from dvf_ig.io import plain
from dvf_ig.preop import signed_distance_mm
from dvf_ig.preop.spline.fit import sample_grid
from dvf_ig.report.style import GUIDE, SERIES, png_bytes
from dvf_ig.study.driver import Driver, Result, Rows, Study, Trials, refusals
from dvf_ig.study.options import option, seed_option, seeds_option
from dvf_ig.study.statistics import number_text
from dvf_ig.study.training.trainers import (
    DEGREES,
    SplineAxis,
    SplineNetwork,
    Trained,
    safe_step,
    train_gradient,
    train_scattered,
    train_separable,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PITCH_MM = 8.0
MAX_ITERATIONS = 3000


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """Options of the study."""

    degrees: tuple[int, ...] = option("Degrees of the B-splines, 1 to 5.", (1, 2, 3))
    seeds: int = seeds_option(1)
    seed: int = seed_option(1)


Clock = Callable[[], float]

GRADIENT, CONJUGATE = "gradient descent", "conjugate gradients"
MARGIN_MM, BAND_MM = 15.0, 4.0
RECORDED = frozenset(np.unique(np.geomspace(1, 1e6, 73).round().astype(int)).tolist())
"""Iterations at which cost is recorded, twelve a decade."""

CLOSE = 0.01
"""Share of the minimal cost within which a training counts as converged."""


EXACT = "exact"
STYLES = {"gradient descent": "-", "conjugate gradients": "--", EXACT: ":"}
FLOOR = 1e-9
"""Smallest excess that is drawn."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class TrainingCurve:
    """Convergence of one method on one network.

    Attributes:
        iteration, seconds: (n,) increasing; one entry for the exact solution.
        excess: (n,) (cost − minimal cost) / minimal cost.
    """

    iteration: IntArray
    seconds: FloatArray
    excess: FloatArray


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Signed distances on a regular grid.

    Attributes:
        positions_mm: (sx,), (sy,) and (sz,) sample positions along the axes.
        values_mm: (sx, sy, sz), positive inside.
        pitch_mm: knot pitch of the networks; the samples lie at half of it.
    """

    positions_mm: tuple[FloatArray, FloatArray, FloatArray]
    values_mm: FloatArray
    pitch_mm: float

    @classmethod
    def of_surface(cls, mesh: Mesh, pitch_mm: float) -> Samples:
        """Samples at half the pitch over a closed surface and a margin of 15 mm, exact within 4 mm of it."""
        grid = sample_grid([mesh], mesh.frame, pitch_mm, MARGIN_MM)
        x, y, z = (
            origin + step * np.arange(n)
            for origin, step, n in zip(grid.origin_mm, grid.spacing_mm, grid.shape, strict=True)
        )
        return cls((x, y, z), signed_distance_mm(mesh, grid, BAND_MM), pitch_mm)

    def network(self, degree: int) -> SplineNetwork:
        """The network of one degree along each axis whose cells cover the samples."""
        x, y, z = (
            SplineAxis(degree, float(p[0]), self.pitch_mm, (len(p) - 1) // 2) for p in self.positions_mm
        )
        return SplineNetwork(x, y, z)


@dataclass(frozen=True, slots=True)
class Training:
    """One method on one network.

    Attributes:
        method: "gradient descent", "conjugate gradients" or "exact".
        stop, iterations: how it ended.
        seconds: of the training, without the recording of its cost.
        rms_mm: root mean square residual at the samples.
        excess: (cost − minimal cost) / minimal cost at the end.
        curve: the same over iterations and time.
    """

    method: str
    stop: str
    iterations: int
    seconds: float
    rms_mm: float
    excess: float
    curve: TrainingCurve


@dataclass(frozen=True, slots=True)
class Comparison:
    """All methods on the network of one degree.

    Attributes:
        degree: of the B-splines along each axis.
        functions: number of basis functions.
        condition: condition number of the quadratic; gradient descent needs about as many steps for a factor
            e.
        trainings: one for each method.
    """

    degree: int
    functions: int
    condition: float
    trainings: tuple[Training, ...]


class _Recorder:
    """Root mean square residual of the coefficients at chosen iterations, and the time that training took."""

    def __init__(self, rms: Callable[[FloatArray], float], clock: Clock) -> None:
        self._rms, self._clock = rms, clock
        self._begin_s, self._recording_s = clock(), 0.0
        self._count = 0
        self.rows: list[tuple[int, float, float]] = []

    def __call__(self, coefficients: FloatArray) -> None:
        self._count += 1
        if self._count in RECORDED:
            now_s = self._clock()
            self.rows.append((self._count, self.elapsed_s(now_s), self._rms(coefficients)))
            self._recording_s += self._clock() - now_s

    def elapsed_s(self, now_s: float) -> float:
        """Time since the start without the recording."""
        return now_s - self._begin_s - self._recording_s


def compare_training(
    samples: Samples, degrees: Sequence[int], *, max_iterations: int, clock: Clock = time.perf_counter
) -> tuple[Comparison, ...]:
    """Train the network of each degree by each method.

    Args:
        samples: of one surface.
        degrees: 1 to 5.
        max_iterations: of gradient descent.
        clock: seconds; only times depend on it.
    Raises:
        InvalidInputError: no degree, or one that does not exist.
    """
    if not degrees or any(degree not in DEGREES for degree in degrees):
        raise InvalidInputError(
            f"spline degrees are {list(degrees)}; needed at least one, each {DEGREES[0]} to {DEGREES[-1]}"
        )
    return tuple(_compare(samples, degree, max_iterations, clock) for degree in degrees)


def _compare(samples: Samples, degree: int, max_iterations: int, clock: Clock) -> Comparison:
    network = samples.network(degree)
    positions, values = samples.positions_mm, samples.values_mm
    points = np.stack(np.meshgrid(*positions, indexing="ij"), axis=-1).reshape(-1, 3)
    design = network.design(points)

    def rms(coefficients: FloatArray) -> float:
        return float(np.sqrt(np.mean((values.ravel() - design @ coefficients.ravel()) ** 2)))

    def timed(method: str, train: Callable[[_Recorder], Trained]) -> tuple[str, Trained, _Recorder, float]:
        recorder = _Recorder(rms, clock)
        trained = train(recorder)
        return method, trained, recorder, recorder.elapsed_s(clock())

    runs = (
        timed(
            GRADIENT,
            lambda record: train_gradient(
                network, positions, values, max_iterations=max_iterations, on_iteration=record
            ),
        ),
        timed(
            CONJUGATE, lambda record: train_scattered(network, points, values.ravel(), on_iteration=record)
        ),
        timed(EXACT, lambda _: train_separable(network, positions, values)),
    )
    minimum = runs[-1][1].rms
    trainings = tuple(_training(minimum, *run) for run in runs)
    _, condition = safe_step(network, positions)
    return Comparison(degree, int(np.prod(network.shape)), condition, trainings)


def _training(
    minimum_mm: float, method: str, trained: Trained, recorder: _Recorder, seconds: float
) -> Training:
    rows = np.array([*recorder.rows, (trained.iterations, seconds, trained.rms)], dtype=np.float64)
    excess = np.maximum((rows[:, 2] / minimum_mm) ** 2 - 1.0, 0.0)
    curve = TrainingCurve(rows[:, 0].astype(np.int64), rows[:, 1], excess)
    return Training(
        method, trained.stop.name, trained.iterations, seconds, trained.rms, float(excess[-1]), curve
    )


def training_trial(settings: dict[str, Any], seed: int) -> dict[str, Any]:
    """One heart: the phantom of this seed at end-diastole.

    Args:
        settings: `degrees`, `pitch_mm`, `max_iterations`.
    """
    phantom = phantom_anatomy(motion="paper5mm", mismatch_mm=0.0, seed=seed)
    mesh = Mesh("mr", phantom.ed_vertices_mm, phantom.triangles)
    samples = Samples.of_surface(mesh, settings["pitch_mm"])
    comparisons = compare_training(samples, settings["degrees"], max_iterations=settings["max_iterations"])
    return {"samples": samples.values_mm.size, "networks": plain(comparisons)}


def summarise_training(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each degree and method, medians over the hearts; a trial that was refused is left out.

    Returns:
        rows of `degree method functions condition iterations seconds rms_mm excess`, and
        `iterations_to_1_percent seconds_to_1_percent` until cost stays within 1 % of its minimum, None if
        a heart did not reach it.
    """
    networks = [network for line in lines if "refused" not in line for network in line["networks"]]
    rows = []
    for degree in dict.fromkeys(network["degree"] for network in networks):
        mine = [network for network in networks if network["degree"] == degree]
        for method in (GRADIENT, CONJUGATE, EXACT):
            every = [t for network in mine for t in network["trainings"] if t["method"] == method]
            arrived = [_arrival(training["curve"]) for training in every]
            rows.append(
                {
                    "degree": degree,
                    "method": method,
                    "functions": _median([network["functions"] for network in mine]),
                    "condition": _median([network["condition"] for network in mine]),
                    **{
                        name: _median([training[name] for training in every])
                        for name in ("iterations", "seconds", "rms_mm", "excess")
                    },
                    "iterations_to_1_percent": _median([iteration for iteration, _ in arrived]),
                    "seconds_to_1_percent": _median([seconds for _, seconds in arrived]),
                }
            )
    return rows


def _arrival(curve: dict[str, list[float]]) -> tuple[float | None, float | None]:
    """Iteration and time of the first record from which on cost stays within 1 % of its minimum."""
    far = np.flatnonzero(np.array(curve["excess"]) > CLOSE)
    first = 0 if len(far) == 0 else int(far[-1]) + 1
    if first == len(curve["excess"]):
        return None, None
    return curve["iteration"][first], curve["seconds"][first]


def _median(values: Sequence[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return float(np.median(numbers)) if numbers and len(numbers) == len(values) else None


def training_figure(networks: Sequence[dict[str, Any]], title: str) -> Figure:
    """Excess cost against iterations and against time; the exact solution is a vertical line at its time.

    Args:
        networks: of one trial's line.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14.0, 4.8), layout="constrained")
    by_iteration, by_time = figure.subplots(1, 2, sharey=True)
    for network in networks:
        color = SERIES[network["degree"] - 1]
        for training in network["trainings"]:
            method, curve = training["method"], training["curve"]
            label = f"degree {network['degree']}, {method}"
            if method == EXACT:
                by_time.axvline(curve["seconds"][-1], color=color, ls=STYLES[EXACT], label=label)
                continue
            for axes, along in ((by_iteration, "iteration"), (by_time, "seconds")):
                drawn = np.maximum(curve["excess"], FLOOR)
                axes.plot(curve[along], drawn, STYLES[method], color=color, label=label)
    by_iteration.set(xlabel="iterations", ylabel="(cost − minimum) / minimum (dotted: 1 %)")
    by_time.set(xlabel="time, s")
    for axes in (by_iteration, by_time):
        _style(axes)
    handles, labels = by_time.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", fontsize=8, frameon=False)
    figure.suptitle(title)
    return figure


def _style(axes: Axes) -> None:
    axes.set(xscale="log", yscale="log")
    axes.axhline(0.01, color=GUIDE, ls=":", lw=0.8)
    axes.grid(alpha=0.3)


def run(settings: TrainingSettings, driver: Driver) -> Result:
    """Train on every seed's heart."""
    fields = {"degrees": list(settings.degrees), "pitch_mm": PITCH_MM, "max_iterations": MAX_ITERATIONS}
    seeds = range(settings.seed, settings.seed + settings.seeds)
    lines = driver.trials(Trials("training", fields, training_trial), seeds, alone=True)
    rows = summarise_training(lines)
    completed = [line for line in lines if "refused" not in line]
    summary = {
        **fields,
        "seed": settings.seed,
        "seeds": settings.seeds,
        "refused": len(lines) - len(completed),
        "rows": rows,
    }
    files: dict[str, Any] = {"summary.json": summary}
    if completed:
        title = f"Training on the distances of phantom {completed[0]['seed']}, knots every {PITCH_MM:g} mm"
        files["training.png"] = png_bytes(training_figure(completed[0]["networks"], title), dpi=100)
    return Result(summary, _table(rows), files, refusals(lines))


def _table(rows: Sequence[dict[str, Any]]) -> Rows:
    head = ("degree", "method", "functions", "condition", "iterations", "seconds", "rms mm", "above minimum")
    return [(*head, "iterations to 1 %", "seconds to 1 %"), *(_cells(row) for row in rows)]


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    arrived = (row["iterations_to_1_percent"], row["seconds_to_1_percent"])
    return (
        str(row["degree"]),
        row["method"],
        f"{row['functions']:.0f}",
        f"{row['condition']:.3g}",
        f"{row['iterations']:.0f}",
        f"{row['seconds']:.3g}",
        f"{row['rms_mm']:.4f}",
        f"{row['excess']:.2g}",
        *(number_text(value, "{:.3g}", "-") for value in arrived),
    )


STUDY = Study(TrainingSettings, run, outputs=lambda _: ("summary.json", "training.png"))
