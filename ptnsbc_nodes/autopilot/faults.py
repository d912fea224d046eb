"""What a test can break in a stand-in."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Faults:
    """Faults that last until they are taken back."""

    no_heartbeat: bool = False
    mute: bool = False  # neither sends nor answers, flies on
    refuse_arming: bool = False
    duplicate: bool = False  # somebody else with our system id on the companion's link
