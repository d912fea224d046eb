"""Times in UTC, as a mission names them: one instant, or a time that recurs every day, hour or minute.

A day has 86 400 s here, as in POSIX: leap seconds do not count.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta, timezone
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, TypeAdapter, ValidationError
from pydantic_core import PydanticCustomError

_SECOND_NS = 1_000_000_000
_UNIX = datetime(1970, 1, 1, tzinfo=timezone.utc)
_DATE = TypeAdapter(datetime)  # datetime.fromisoformat knows no Z before Python 3.11
_TIME_OF_DAY = re.compile(
    r"(\*|[01]\d|2[0-3]):(\*|[0-5]\d):([0-5]\d)(?:\.(\d{1,6}))?Z",
    re.ASCII,
)


class UtcTime(NamedTuple):
    """A time in UTC [ns]."""

    first_ns: int  # since 1970; of one that recurs, the first one after 1970 began
    period_ns: int  # 0: it does not recur

    def next_ns(self, now_ns: int) -> int:
        """The instant; of a time that recurs, the first one from `now_ns` on."""
        if self.period_ns == 0:
            return self.first_ns
        return now_ns + (self.first_ns - now_ns) % self.period_ns

    def after(self, start: UtcTime) -> int:
        """The time [ns] from `start` to the first one after it; negative for one instant before another."""
        apart_ns = self.first_ns - start.first_ns
        return apart_ns % self.period_ns if self.period_ns else apart_ns

    def follows(self, start: UtcTime) -> bool:
        """True if the time from `start` to the first one after it is always the same."""
        if self.period_ns == 0:
            return start.period_ns == 0
        return start.period_ns % self.period_ns == 0


def utc_time(text: str) -> UtcTime:
    """The time that a text names: `2026-11-22T12:00:05Z`, `12:00:05Z`, `*:00:05Z`, `*:*:05Z`.

    Raises:
        ValueError: a text of another form.
    """
    found = _TIME_OF_DAY.fullmatch(text)
    if found is None:
        if not text.endswith("Z"):
            raise ValueError(text)
        since = _DATE.validate_python(text) - _UNIX
        return UtcTime(since // timedelta(microseconds=1) * 1000, 0)
    hour, minute, second, fraction = found.groups()
    if minute == "*" != hour:
        raise ValueError(text)
    whole_s, period_s = int(second), 60
    if minute != "*":
        whole_s, period_s = whole_s + 60 * int(minute), 3600
    if hour != "*":
        whole_s, period_s = whole_s + 3600 * int(hour), 86_400
    return UtcTime(
        whole_s * _SECOND_NS + int((fraction or "").ljust(9, "0")), period_s * _SECOND_NS
    )


def _utc(value: Any) -> Any:
    """A time in UTC, as text."""
    try:
        if isinstance(value, str):
            utc_time(value)
            return value
    except (ValueError, ValidationError):
        pass
    raise PydanticCustomError(
        "utc",
        "expected a time in UTC, such as 2026-11-22T12:00:05Z, or 12:00:05Z for one of every day, "
        "*:00:05Z of every hour, *:*:05Z of every minute",
        {"value": value},
    )


Utc = Annotated[str, BeforeValidator(_utc)]
