"""The verdict on a recorded flight: deadline met, missed or void, with input and separations."""

from ptnsbc_sim.verdict.figures import Separation
from ptnsbc_sim.verdict.recording import Recording, VerdictError
from ptnsbc_sim.verdict.track import Series, Track
from ptnsbc_sim.verdict.verdict import Verdict, verdict_and_errors, verdict_on

__all__ = [
    "Recording",
    "Separation",
    "Series",
    "Track",
    "Verdict",
    "VerdictError",
    "verdict_and_errors",
    "verdict_on",
]
