"""What was left to the photos to decide, and why it was decided so."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Decision:
    """A setting that was left to the photos. figure: the measurement that decided it, None where too little was seen.
    because: why, in words."""

    setting: str
    value: str | int
    figure: float | None
    because: str
