"""A flight and the file of its scenario, for the tests of readers."""

from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def flown(fly):
    """UAV 3 is 20 cm beside its place until 4 s after the epoch."""
    return fly({3: lambda t: np.where(t < 4.0, 0.2, 0.0)})


@pytest.fixture
def scenario_file(flown, tmp_path) -> Path:
    path = tmp_path / "scenario.yaml"
    path.write_text(flown.scenario.text)
    return path
