"""PTNSBC as a library: load or write a scenario, check it, fly it, judge it, read bags, fly sweeps.

    import ptnsbc

    scenario = ptnsbc.load("paper_5").with_({"gains.formation.deadline_s": 6})
    flight = ptnsbc.fly(scenario)
    print(flight.verdict.verdict, flight.error_m.max())
    flight.plot_errors()

docs/library.md says more. What this module names stays; modules below it may change. `progress`: show progress on
stderr; by default in a terminal and in a notebook.
"""

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_sim.scenario import Scenario, available
from ptnsbc_sim.sweep.family import families
from ptnsbc_sim.verdict import Verdict
from ptnsbc_tools.check import CheckReport, Finding
from ptnsbc_tools.doctor import examine as doctor
from ptnsbc_tools.library.bags import Repaired, repair, rerun
from ptnsbc_tools.library.flight import QUANTITIES, Flight, Quantity
from ptnsbc_tools.library.flying import check, fly, fly_fleet, load, read_bag, verdict
from ptnsbc_tools.library.new_scenario import new
from ptnsbc_tools.library.reporting import Report, export, report
from ptnsbc_tools.library.sweeping import Sweep, compare, open_sweep, sweep
from ptnsbc_tools.replay.rerun import Rerun
from ptnsbc_tools.sweeps.comparison import SweepComparison
from ptnsbc_tools.sweeps.summary import Share
from ptnsbc_tools.tables import Summary

__all__ = [
    "new",
    "doctor",
    "available",
    "families",
    "load",
    "check",
    "fly",
    "fly_fleet",
    "read_bag",
    "verdict",
    "sweep",
    "open_sweep",
    "compare",
    "export",
    "report",
    "rerun",
    "repair",
    "Scenario",
    "CheckReport",
    "Finding",
    "Report",
    "Rerun",
    "Repaired",
    "Flight",
    "Verdict",
    "Sweep",
    "Share",
    "SweepComparison",
    "Summary",
    "Quantity",
    "QUANTITIES",
    "PtnsbcError",
]
