"""The verdict on a recorded flight: met, missed, violated or void, with input and separations."""

from ptnsbc_sim.verdict.recording import Recording, VerdictError
from ptnsbc_sim.verdict.separation import Separation
from ptnsbc_sim.verdict.track import Track
from ptnsbc_sim.verdict.verdict import Verdict, verdict_on

__all__ = ["Recording", "Separation", "Track", "Verdict", "VerdictError", "verdict_on"]
