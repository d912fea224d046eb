"""The JSON schema of a family file, for editors; `family.schema.json` beside this module is the output."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ptnsbc_sim.scenario.schema import as_text, described, headed
from ptnsbc_sim.sweep.family import Family

FILE = Path(__file__).with_name("family.schema.json")
"""The schema that the modeline of a family file names."""


def schema() -> dict[str, Any]:
    """JSON schema, draft 2020-12, of a family file."""
    told = "Distributions of scenarios, for ptnsbc sweep --family. docs/sweeps.md explains it."
    return headed(described(Family), "Family of scenarios of ptnsbc", told)


def text() -> str:
    """The schema as the committed file holds it."""
    return as_text(schema())
