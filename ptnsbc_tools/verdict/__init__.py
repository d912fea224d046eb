"""The verdict on a recorded flight: deadline met, missed or void, and what it cost."""

from ptnsbc_tools.verdict.recording import Counters, Recording, Series, VerdictError
from ptnsbc_tools.verdict.verdict import Verdict, verdict_on

__all__ = ["Counters", "Recording", "Series", "Verdict", "VerdictError", "verdict_on"]
