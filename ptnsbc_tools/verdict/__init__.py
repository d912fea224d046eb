"""The verdict on a recorded flight: deadline met, missed or void, with input and separations."""

from ptnsbc_tools.verdict.recording import Recording, VerdictError
from ptnsbc_tools.verdict.track import Series, Track
from ptnsbc_tools.verdict.verdict import Verdict, verdict_on

__all__ = ["Recording", "Series", "Track", "Verdict", "VerdictError", "verdict_on"]
