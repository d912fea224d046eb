"""A flight as arrays, tables and figures: headless, of a fleet, or from a bag."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ptnsbc_core.agent import GAIN, SINGULAR_VALUE
from ptnsbc_core.errors import PtnsbcError
from ptnsbc_core.types import Array
from ptnsbc_sim.scenario import Scenario
from ptnsbc_sim.scenario.problems import similar
from ptnsbc_sim.verdict import Recording, Track, Verdict, verdict_on
from ptnsbc_sim.verdict.formation_error import formation_errors
from ptnsbc_sim.verdict.recording import Instants, require_all_uavs, tolerance_of, whole
from ptnsbc_tools import ros
from ptnsbc_tools.limits import path_of
from ptnsbc_tools.options import AS_RECORDED, ReadOptions
from ptnsbc_tools.plotting import draw
from ptnsbc_tools.plotting.charts import CHARTS, Chart, FlightView, view_of
from ptnsbc_tools.reading.bag_reader import StatusSeries, read_recording, read_status
from ptnsbc_tools.tables import Summary, verdict_summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ptnsbc_sim.swarm import HeadlessFlight


class FlightError(PtnsbcError):
    """Something that a flight does not have."""


TIME, UAV, XYZ, XYZW = "time_s", "uav", "axis", "component"
"""Names of the axes of the arrays."""

COORDINATES: dict[str, tuple[str, ...]] = {XYZ: ("x", "y", "z"), XYZW: ("x", "y", "z", "w")}
"""Labels along the axes that do not depend on the flight."""


class Quantity(NamedTuple):
    """One array of a flight."""

    name: str  # of the property of Flight
    unit: str
    axes: tuple[str, ...]
    meaning: str


QUANTITIES: tuple[Quantity, ...] = (
    Quantity("time_s", "s", (TIME,), "Time after the epoch."),
    Quantity("position_m", "m", (TIME, UAV, XYZ), "Position, ENU; the true one where it is known."),
    Quantity("velocity_m_s", "m/s", (TIME, UAV, XYZ), "Velocity as measured, ENU."),
    Quantity(
        "quaternion", "", (TIME, UAV, XYZW), "Attitude as measured: body FLU to world ENU, x y z w."
    ),
    Quantity("rate_rad_s", "rad/s", (TIME, UAV, XYZ), "Body rate as measured, FLU."),
    Quantity("force_n", "N", (TIME, UAV, XYZ), "Commanded force, FLU; NaN where none is recorded."),
    Quantity("torque_n_m", "N m", (TIME, UAV, XYZ), "Commanded torque, FLU; NaN likewise."),
    Quantity(
        "leader_estimate_m", "m", (TIME, UAV, XYZ), "A UAV's estimate of the leader; NaN likewise."
    ),
    Quantity(
        "error_m", "m", (TIME, UAV), "Distance from its place; of the leader, from its trajectory."
    ),
)
"""All arrays of a flight, in the order in which tables show them."""


_MEANINGS = {quantity.name: quantity.meaning for quantity in QUANTITIES}


def _columns(name: str, track: str, first: int, end: int) -> cached_property[Array]:
    """A quantity of a flight: columns first … end - 1 of a track of every UAV; NaN where none is recorded."""

    def columns(flight: FlightArrays) -> Array:
        tracks, grid = getattr(flight.recording, track), flight.instants.stamps
        nothing = np.full((grid.size, end - first), np.nan)
        parts = [
            tracks[uav].at(grid)[:, first:end] if uav in tracks else nothing for uav in flight.uavs
        ]
        return np.stack(parts, axis=1)

    columns.__doc__ = _MEANINGS.get(name)
    return cached_property(columns)


@dataclass(frozen=True)
class FlightArrays:
    """The quantities of a flight as NumPy arrays, at the leader's stamps of one formation leg."""

    recording: Recording = field(repr=False)

    @property
    def scenario(self) -> Scenario:
        """The scenario that was flown."""
        return self.recording.scenario

    @property
    def uavs(self) -> tuple[int, ...]:
        """Ids of the UAVs, in the order of the arrays."""
        return self.scenario.uav_ids

    @cached_property
    def instants(self) -> Instants:
        """The instants, and the positions at them."""
        require_all_uavs(self.recording)
        return whole(self.recording)

    @cached_property
    def time_s(self) -> Array:
        """Time after the epoch (T,) [s]."""
        return self.instants.times

    @cached_property
    def position_m(self) -> Array:
        """Position (T, N, 3) [m], ENU; the true one where it is known."""
        return np.ascontiguousarray(self.instants.positions.T)

    quaternion = _columns("quaternion", "odometry", 3, 7)
    rate_rad_s = _columns("rate_rad_s", "odometry", 10, 13)
    force_n = _columns("force_n", "wrench", 0, 3)
    torque_n_m = _columns("torque_n_m", "wrench", 3, 6)
    leader_estimate_m = _columns("leader_estimate_m", "estimate", 0, 3)
    _body_velocity = _columns("velocity, FLU", "odometry", 7, 10)

    @cached_property
    def velocity_m_s(self) -> Array:
        """Velocity as measured (T, N, 3) [m/s], ENU."""
        vector, scalar = self.quaternion[..., :3], self.quaternion[..., 3:]
        turn = 2.0 * np.cross(vector, self._body_velocity)
        return np.asarray(self._body_velocity + scalar * turn + np.cross(vector, turn))

    @cached_property
    def error_m(self) -> Array:
        """Formation error (T, N) [m]: distance from its place; of the leader, from its trajectory."""
        return np.ascontiguousarray(formation_errors(self.recording, self.instants).T)

    def __getitem__(self, name: str) -> Array:
        """A quantity by its name, as in `flight["error_m"]`."""
        names = [one.name for one in QUANTITIES]
        if name not in names:
            raise FlightError(f"{name}: no quantity of a flight: {similar(name, names)}")
        values: Array = getattr(self, name)
        return values

    def columns(self) -> Iterator[tuple[str, str, NDArray[Any]]]:
        """Name, unit and values (T * N,) of every column of a table: `time_s`, `uav`, `position_m.x`, …"""
        yield TIME, "s", np.repeat(self.time_s, len(self.uavs))
        yield UAV, "", np.tile(self.uavs, self.time_s.size)
        for one in QUANTITIES[1:]:
            values = self[one.name].reshape(self.time_s.size * len(self.uavs), -1)
            labels = COORDINATES.get(one.axes[-1])
            if labels is None:
                yield one.name, one.unit, values[:, 0]
            else:
                for column, label in enumerate(labels):
                    yield f"{one.name}.{label}", one.unit, values[:, column]


@dataclass(frozen=True)
class Flight(FlightArrays):
    """A flight: its verdict, and its quantities as NumPy arrays.

    Every array has the same T instants: the leader's stamps of one formation leg. T is the number of instants, N that
    of UAVs, in the order of `uavs`. The names of arrays end with their unit. World axes are east, north, up (ENU);
    body axes are front, left, up (FLU).
    """

    tolerance_m: float | None = field(default=None, repr=False)
    """Limit of the error at the deadline [m]; None: that of the scenario."""
    bag: Path | None = None
    """The file that it was read from or written to."""
    headless: HeadlessFlight | None = field(default=None, repr=False)
    """The record of the simulator, of a flight in this process."""
    status: StatusSeries | None = field(default=None, repr=False)
    """The published messages of the nodes; None: read from the bag when a figure needs them."""

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict with all figures (docs/verdict.md); VerdictError when the recording cannot be judged."""
        return verdict_on(self.recording, self.tolerance_m)

    @property
    def summary(self) -> Summary:
        """The figures of every UAV in the verdict."""
        return verdict_summary(self.verdict)

    @property
    def legs(self) -> tuple[Flight, ...]:
        """The flight once for each of its formation legs; arrays and figures are of that leg."""
        numbers = range(len(self.recording.forms))
        return tuple(replace(self, recording=replace(self.recording, leg=k)) for k in numbers)

    def to_pandas(self) -> Any:
        """One row for each instant and UAV as a pandas DataFrame; `attrs["units"]` has the units."""
        pandas = ros.library("pandas", "to_pandas()")
        columns = list(self.columns())
        frame = pandas.DataFrame({name: values for name, _, values in columns})
        units = {name: unit for name, unit, _ in columns}
        frame.attrs = {"units": units, "scenario": self.scenario.name}
        return frame

    @cached_property
    def view(self) -> FlightView:
        """The flight as the figures of `ptnsbc plot` and `ptnsbc report` show it."""
        status = self.status or StatusSeries()
        if self.status is None and self.headless is not None:
            flown = self.headless  # at every tick what the UAVs would have published
            columns = {"gain": GAIN, "sigma_min": SINGULAR_VALUE}
            values = flown.track.diagnostics
            status = {
                key: {
                    uav: Track(flown.t_ns, values[:, row, column : column + 1])
                    for row, uav in enumerate(self.uavs)
                }
                for key, column in columns.items()
            }
        elif self.status is None and self.bag is not None:
            status = read_status(self.bag)
        return view_of(self.recording, status, self.tolerance_m, self.bag)

    def plot(
        self,
        what: str = "errors",
        axes: Axes | None = None,
        *,
        legend: bool = True,
        labels: bool = True,
    ) -> Axes:
        """Draw a figure of `ptnsbc plot --what` on Matplotlib axes, by default on new ones, and return them.

        Sizes are those of `rcParams`. `legend` names the curves below the axes, where a figure with
        `layout="constrained"` has room for it; `labels` names limits and times at their lines.
        FlightError when there is no such figure, or the flight has no data for it.
        """
        chart = self._chart(what)
        axes = new_axes() if axes is None else axes
        draw.draw_chart(axes, chart, legend=legend, labels=labels)
        return axes

    def _chart(self, what: str) -> Chart:
        if what not in CHARTS:
            raise FlightError(f"{what}: no figure of a flight: {similar(what, CHARTS)}")
        chart = self.view.chart(what)
        if chart is None:
            reason = self.view.problem or "the flight has no data for it"
            raise FlightError(f"{what}: nothing to draw: {reason}")
        return chart

    def plot_errors(
        self, axes: Axes | None = None, *, legend: bool = True, labels: bool = True
    ) -> Axes:
        """Draw the formation errors with deadline and tolerance on Matplotlib axes, and return them; see `plot`."""
        return self.plot("errors", axes, legend=legend, labels=labels)

    def plot_paths(self, axes: Axes | None = None, *, legend: bool = True) -> Axes:
        """Draw paths, the formation and obstacles from above on Matplotlib axes, and return them; see `plot`."""
        axes = new_axes() if axes is None else axes
        draw.draw_paths(axes, self.recording, legend=legend)
        return axes

    def save_picture(
        self, path: str | Path, what: str | None = None, *, columns: str | None = None
    ) -> Path:
        """Draw paths and errors into a PNG, SVG or PDF, as `ptnsbc verify --picture` does, and return its path.

        `what`: instead one figure, as `ptnsbc plot --what`; `columns`: for "one" or "two" columns of a journal. A PDF
        holds its fonts as TrueType. FlightError as `plot`.
        """
        if what is not None:
            with draw.sized(columns):
                figure = draw.figure_of(self._chart(what), self.scenario.name, columns)
                return draw.save(figure, path_of("path", path))
        limit_m = tolerance_of(self.recording, self.tolerance_m)
        shown = FlightView(self.recording, StatusSeries(), limit_m, self.verdict, "", self.bag)
        return draw.draw_flight(shown, path_of("path", path))

    def save(
        self,
        folder: str | Path,
        *,
        overwrite: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ) -> Flight:
        """Write a headless flight into a bag, and return the flight with its bag; needs the ROS message packages.

        `progress` is called now and then with the ticks done and their total. FlightError when the flight comes from a
        bag; BagError when the folder is not empty, without `overwrite`.
        """
        from ptnsbc_tools.reading.headless import write_flight

        if self.headless is None:
            raise FlightError(f"save: the flight is in a bag already: {self.bag}")
        written = write_flight(
            self.headless, path_of("folder", folder), overwrite=overwrite, progress=progress
        )
        return replace(self, bag=written)

    def _word(self) -> str:
        try:
            return self.verdict.verdict
        except PtnsbcError as error:
            return f"none: {error}"

    def __repr__(self) -> str:
        return (
            f"<Flight of {self.scenario.name}: {len(self.uavs)} UAVs, "
            f"{self.recording.samples} instants, verdict {self._word()}>"
        )


def new_axes() -> Axes:
    """Matplotlib axes on a new figure."""
    from matplotlib import pyplot

    return pyplot.subplots(layout="constrained")[1]


def flight_in(bag: Flight | str | Path, options: ReadOptions = AS_RECORDED) -> Flight:
    """The flight in a bag, or this one; BagError when there is none, or it is cut, damaged, or without a scenario."""
    if isinstance(bag, Flight):
        return bag
    path = path_of("bag", bag)
    return Flight(read_recording(path, options), options.tolerance_m, path)
